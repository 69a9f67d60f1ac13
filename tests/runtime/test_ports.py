"""The programs in other languages beside the exported model's page compute what ONNX Runtime in Python does."""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from nte.errors import NteError
from nte.frames.clip import Clip
from nte.runtime.onnx_file import operators_of
from nte.runtime.vectors import write_vectors
from tests.evaluation.conftest import noisy_frames
from tests.runtime.packages import EXPORT, needs, with_packages
from tests.shared import made_once
from tests.synthetic import write_clip
from tests.viewer.browser import Browser, needs_chromium

FRAMES = 20
CPP_NEEDS = ("npm", "cmake", "ninja", "c++")
FOUND = re.compile(r"^with the state (.*): (\d+) frames, largest difference ([-+.\de]+) \(", re.MULTILINE)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A noisy disc that moves by a fraction of a pixel, of an odd size."""

    def make(folder: Path) -> None:
        write_clip(folder / "disc", noisy_frames(FRAMES, size=(43, 61)))

    return made_once(tmp_path_factory, "ports_clip", make) / "disc"


@pytest.fixture(scope="module")
def vectors(model: Path, clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders of test vectors: `clip`, with 20 frames of it, and `hard`, with four as nte export writes them."""

    def make(folder: Path) -> None:
        write_vectors(model, folder / "clip", Clip(clip))
        write_vectors(model, folder / "hard")

    return made_once(tmp_path_factory, "ports_vectors", make)


@pytest.fixture(scope="module")
def node(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = with_packages("node", tmp_path_factory.mktemp("node") / "consumer")
    return ["node", str(folder / "check.mjs")]


@pytest.fixture(scope="module")
def cpp(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    json_package = importlib.util.find_spec("nlohmann_json")
    if json_package is None or json_package.origin is None:
        pytest.skip("nlohmann-json is not installed: pip install nlohmann-json")
    folder = with_packages("cpp", tmp_path_factory.mktemp("cpp") / "consumer")
    (folder / "mistakes.cpp").write_text(MISTAKES_CPP)
    with (folder / "CMakeLists.txt").open("a") as lists:
        lists.write(
            "add_executable(mistakes mistakes.cpp)\n"
            "target_link_libraries(mistakes PRIVATE nte_denoiser)\n"
            "set_target_properties(mistakes PROPERTIES BUILD_RPATH ${CMAKE_BINARY_DIR})\n"
        )
    build = folder / "build"
    prefix = Path(json_package.origin).parent
    flags = [f"-DCMAKE_PREFIX_PATH={prefix}", "-DCMAKE_CXX_FLAGS=-Wall -Wextra -Wpedantic -Werror", "-G", "Ninja"]
    for command in (["cmake", "-S", str(folder), "-B", str(build), *flags], ["cmake", "--build", str(build)]):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert not done.returncode, done.stdout + done.stderr
    return [str(build / "check")]


@pytest.fixture(
    params=[
        pytest.param("node", marks=needs("node", "npm")),
        pytest.param("cpp", marks=needs(*CPP_NEEDS)),
    ]
)
def check(request: pytest.FixtureRequest) -> list[str]:
    """The command of a program that checks a model against vectors."""
    command: list[str] = request.getfixturevalue(request.param)
    return command


def run(command: list[str], *arguments: Path) -> tuple[int, str]:
    done = subprocess.run([*command, *map(str, arguments)], capture_output=True, text=True, timeout=300, check=False)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.slow
def test_a_program_agrees_with_python(check: list[str], model: Path, vectors: Path) -> None:
    for name, frames, limit in (("clip", FRAMES, 1e-4), ("hard", 4, 1e-3)):
        code, said = run(check, model, vectors / name)
        print(f"{Path(check[-1]).name}, {name}: {said}")
        assert code == 0, said
        found = FOUND.findall(said)
        assert [way for way, _, _ in found] == ["of the files", "it keeps"]
        assert all(int(count) == frames and float(worst) < limit for _, count, worst in found), said


@pytest.mark.slow
def test_a_program_sees_what_is_wrong(check: list[str], model: Path, vectors: Path, tmp_path: Path) -> None:
    """Each way of running sees what it must: a state in the files that is wrong, and another output."""
    wrong = shutil.copytree(vectors / "hard", tmp_path / "wrong")
    history = np.fromfile(wrong / "2" / "history.f32", "<f4")
    (1.5 * history).astype("<f4").tofile(wrong / "2" / "history.f32")
    code, said = run(check, model, wrong)
    assert code == 1
    assert [float(worst) > 1e-3 for _, _, worst in FOUND.findall(said)] == [True, False]
    history.tofile(wrong / "2" / "history.f32")
    image = np.fromfile(wrong / "3" / "image.f32", "<f4")
    image[-1] *= 1.01
    image.tofile(wrong / "3" / "image.f32")
    code, said = run(check, model, wrong)
    assert code == 1
    assert said.count("image of frame 3") == 2
    assert said.count("more than 0.001") == 2


MISTAKES_NODE = """
import { readFileSync } from "node:fs";
import * as ort from "onnxruntime-node";
import { Denoiser } from "./denoiser.mjs";
import { difference } from "./vectors.mjs";
const [model, folder] = process.argv.slice(2);
const { frames } = JSON.parse(readFileSync(`${folder}/vectors.json`));
const tensor = ({ file, shape }) =>
  new ort.Tensor("float32", new Float32Array(new Uint8Array(readFileSync(`${folder}/${file}`)).buffer), shape);
const read = (listed) => Object.fromEntries(Object.entries(listed).map(([name, entry]) => [name, tensor(entry)]));
const denoiser = await Denoiser.load(ort, readFileSync(model));
for (const frame of frames) {
  const inputs = read(frame.inputs);
  const smaller = new ort.Tensor("float32", new Float32Array(3 * 32 * 32), [1, 3, 32, 32]);
  const mistakes = [{ exposure: undefined }, { motion: undefined }, { color: smaller }];
  for (const mistake of mistakes.slice(0, frame === frames[0] ? 2 : 3)) // the first frame may have any size
    await denoiser.denoise({ ...inputs, ...mistake }).catch((error) => console.log(error.message));
  const { image } = await denoiser.denoise(inputs);
  console.log(difference(image.data, tensor(frame.outputs.image).data) < 1e-3);
}
"""

MISTAKES_CPP = """
#define main check
#include "check.cpp"
#undef main
int main(int, char** arguments) {
    const Path folder = arguments[2];
    std::ifstream stream(folder / "vectors.json");
    nte::Denoiser denoiser(arguments[1]);
    bool first = true;
    const Json index = Json::parse(stream);
    for (const auto& frame : index.at("frames")) {
        const nte::Tensors inputs = read(folder, frame.at("inputs"));
        std::vector<nte::Tensors> mistakes(first ? 2 : 3, inputs);  // the first frame may have any size
        mistakes[0].erase("exposure");
        mistakes[1].erase("motion");
        if (!first) mistakes[2]["color"] = {{1, 3, 32, 32}, std::vector<float>(3 * 32 * 32)};
        for (const auto& mistake : mistakes) {
            try {
                denoiser.denoise(mistake);
            } catch (const std::exception& error) {
                std::puts(error.what());
            }
        }
        const auto made = denoiser.denoise(inputs);
        const auto expected = read(folder, frame.at("outputs"));
        std::puts(difference(made.at("image").values, expected.at("image").values) < 1e-3 ? "true" : "false");
        first = false;
    }
}
"""


def judge_mistakes(said: str, motion: str, size: str) -> None:
    """Four frames, each after two or three that failed, with the message for a missing channel and another size."""
    assert said.count("true") == 4, said
    assert said.count(motion) == 4, said
    assert said.count(f"batch, height and width are {size}: call reset before another size") == 3, said


@pytest.mark.slow
@needs("node", "npm")
def test_a_sequence_goes_on_after_a_mistake_in_node(node: list[str], model: Path, vectors: Path) -> None:
    """In the first frame as well, whose state is that of no frame."""
    script = Path(node[1]).with_name("mistakes.mjs")
    script.write_text(MISTAKES_NODE)
    code, said = run(["node", str(script)], model, vectors / "hard")
    assert code == 0, said
    judge_mistakes(said, "the frame lacks motion; it has ", "1,32,32 after 1,40,48")


@pytest.mark.slow
@needs(*CPP_NEEDS)
def test_a_sequence_goes_on_after_a_mistake_in_cpp(cpp: list[str], model: Path, vectors: Path) -> None:
    code, said = run([str(Path(cpp[0]).with_name("mistakes"))], model, vectors / "hard")
    assert code == 0, said
    judge_mistakes(said, "the input 'motion' is missing", "1, 32, 32 after 1, 40, 48")


@pytest.mark.slow
def test_a_file_that_is_no_model_is_told(check: list[str], vectors: Path, tmp_path: Path) -> None:
    import onnx

    opset = [onnx.helper.make_opsetid("", 18)]
    nodes = [onnx.helper.make_node("Identity", ["a"], ["b"])]
    ends = [[onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [1])] for name in "ab"]
    foreign = onnx.helper.make_model(onnx.helper.make_graph(nodes, "foreign", *ends), ir_version=9, opset_imports=opset)
    onnx.save(foreign, tmp_path / "foreign.onnx")
    code, said = run(check, tmp_path / "foreign.onnx", vectors / "hard")
    assert code == 2
    assert len(said.splitlines()) == 1
    assert "not a model of nte: no key 'nte' in its metadata" in said


@pytest.mark.slow
def test_a_damaged_model_is_told(check: list[str], model: Path, vectors: Path, tmp_path: Path) -> None:
    content = bytearray(model.read_bytes())
    content[len(content) // 2] ^= 1  # a bit of a weight: the graph would still run
    (tmp_path / "damaged.onnx").write_bytes(content)
    code, said = run(check, tmp_path / "damaged.onnx", vectors / "hard")
    assert code == 2
    assert said.splitlines() == [
        f"{tmp_path / 'damaged.onnx'}: damaged: its checksum does not fit: copy or export it again"
    ]


def preparation() -> ModuleType:
    """The script export/web/prepare.py, which is no part of a package."""
    spec = importlib.util.spec_from_file_location("prepare", EXPORT / "web" / "prepare.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def page(model: Path, clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of the page with 20 frames of the clip."""
    folder = tmp_path_factory.mktemp("web")
    packages = with_packages("web", folder / "consumer") / "node_modules"
    index = preparation().prepare(model, clip, folder / "page", FRAMES, packages)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(index.parent))) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


@pytest.mark.slow
@needs("npm")
@needs_chromium
def test_the_page_plays_a_clip_and_agrees_with_python(page: str, tmp_path: Path) -> None:
    browser = Browser(tmp_path / "profile", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1")
    try:
        browser.size(900, 700)
        browser.call("Page.navigate", url=page)
        browser.wait("Number(document.body?.dataset.shown) >= 1")
        browser.wait(f"Number(document.body?.dataset.shown) > {FRAMES}")  # once around
        found = browser.run("({...document.body.dataset})")
        print(found)
        complaints = [
            line for line in browser.errors if "No available adapters" not in line
        ]  # Chromium lacks a GPU here
        assert complaints == []
        assert found["provider"] in ("WebAssembly", "WebGPU")
        assert float(found["worst"]) < (1e-4 if found["provider"] == "WebAssembly" else 1e-3)
        assert float(found["time"]) > 0
        colours = "new Set(new Uint32Array({}.getContext('2d').getImageData(0, 0, 61, 43).data.buffer)).size"
        assert all(browser.run(colours.format(canvas)) > 500 for canvas in ("noisy", "denoised"))
        browser.run("document.querySelector('button').click()")
        browser.run("new Promise(done => setTimeout(done, 500))")
        stopped = browser.run("document.body.dataset.shown")
        browser.run("new Promise(done => setTimeout(done, 500))")
        assert browser.run("document.body.dataset.shown") == stopped
        picture = Path(os.environ.get("NTE_PICTURES", tmp_path)) / "web.png"
        picture.write_bytes(browser.picture())
    finally:
        browser.close()


WHERE = """(async () => {
  const modules = ["denoiser", "ort.webgpu.bundle.min", "vectors"].map((name) => import(`/${name}.mjs`));
  const [{ Denoiser }, ort, { difference, readIndex, readTensors }] = await Promise.all(modules);
  const read = async (file) => (await fetch(`/clip/${file}`)).arrayBuffer();
  const options = { executionProviders: ["webgpu"], logSeverityLevel: 3 };
  const bytes = new Uint8Array(await (await fetch("/model.onnx")).arrayBuffer());
  const denoiser = await Denoiser.load(ort, bytes, options, "gpu-buffer");
  const { frames } = await readIndex(read);
  let [places, worst] = [undefined, 0];
  for (const index of [0, 1, 0, 1]) {
    if (index === 0) denoiser.reset();
    const inputs = await readTensors(ort, frames[index].inputs, read);
    const { image, next_history } = await denoiser.denoise(inputs, ["image", "next_history"]);
    const expected = await readTensors(ort, { image: frames[index].outputs.image }, read);
    places = `image: ${image.location}, state: ${next_history.location}`;
    worst = Math.max(worst, difference(image.data, expected.image.data));
  }
  return { places, worst };
})()"""


@pytest.mark.slow
@needs("npm")
@needs_chromium
def test_the_state_stays_on_the_gpu(page: str, model: Path, tmp_path: Path) -> None:
    """Also over a reset; on a GPU that Chromium plays in software."""
    software = ("--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader")
    browser = Browser(tmp_path / "profile", *software, "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1")
    try:
        browser.call("Page.navigate", url=page + "clip/vectors.json")
        browser.wait("document.readyState === 'complete'")
        if not browser.run("navigator.gpu?.requestAdapter().then(Boolean)"):
            pytest.skip("Chromium has no WebGPU here, not even in software")
        found = browser.run(WHERE)
        assert found["places"] == "image: cpu, state: gpu-buffer"
        assert found["worst"] < 1e-3
        browser.errors.clear()  # this file has no icon
        browser.call("Page.navigate", url=page)
        browser.wait("Number(document.body?.dataset.shown) > 1")
        found = browser.run("({...document.body.dataset})")
        assert browser.errors == []
        assert found["provider"] == "WebGPU"
        assert float(found["worst"]) < 1e-3
        browser.run("document.querySelector('#ask').click()")
        browser.wait("document.querySelector('#refused').value !== ''")
        refused = set(browser.run("document.querySelector('#refused').value").split(", "))
        assert {"IsInf", "IsNaN"} <= refused <= operators_of(model)
        assert not refused & {"Conv", "GridSample", "Resize"}  # which cost time
        assert browser.errors == []  # of what its log says, nothing is left on the console
    finally:
        browser.close()


def test_no_operator_needs_float64(model: Path) -> None:
    """Which ONNX Runtime's build for WebGPU lacks, and graphics cards compute slowly."""
    import onnx

    graph = onnx.shape_inference.infer_shapes(onnx.load(model)).graph
    branches = [a.g for node in graph.node for a in node.attribute if a.type == onnx.AttributeProto.GRAPH]
    casts = [node for part in (graph, *branches) for node in part.node if node.op_type == "Cast"]
    assert casts
    assert not [node.name for node in casts if node.attribute[0].i == onnx.TensorProto.DOUBLE]
    assert any(node.op_type == "IsInf" for node in graph.node)


def test_a_page_needs_frames_and_its_packages(model: Path, clip: Path, tmp_path: Path) -> None:
    with pytest.raises(NteError, match="--frames is -1, expected 1 or more"):
        preparation().prepare(model, clip, tmp_path / "page", -1)
    with pytest.raises(NteError, match=r"ort\.webgpu\.bundle\.min\.mjs: does not exist: run npm ci in "):
        preparation().prepare(model, clip, tmp_path / "page", packages=tmp_path)
    assert not (tmp_path / "page").exists()


def test_vectors_of_a_clip_are_its_frames(vectors: Path, clip: Path) -> None:
    frames = json.loads((vectors / "clip" / "vectors.json").read_text("utf-8"))["frames"]
    assert len(frames) == FRAMES
    for index in (0, 7):
        for name in ("color", "previous_forward_motion"):
            entry = frames[index]["inputs"][name]
            values = np.fromfile(vectors / "clip" / entry["file"], "<f4").reshape(entry["shape"])
            np.testing.assert_array_equal(values, Clip(clip).frame(index)[name])
