"""Whole files as somebody would make them who wants to run code, read secrets or take all memory: not by chance."""

import io
import json
import zipfile

import numpy as np

from tests.faults.mutations import CANARY, RUN, SECRET

PICKLE = f"cos\nsystem\n(S'{RUN}'\ntR.".encode()  # whoever unpickles it runs the command
ROOM = (
    '<scene version="3.0.0"><sensor type="perspective"><film type="hdrfilm"/></sensor>'
    '<shape type="sphere" id="mesh"/><emitter type="point" id="bulb"/></scene>'
)


def _zip(members: dict[str, bytes | str]) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as file:
        for name, data in members.items():
            file.writestr(name, data)
    return content.getvalue()


def _objects() -> bytes:
    """An .npy file of objects, which NumPy unpickles where it is allowed to."""
    content = io.BytesIO()
    np.lib.format.write_array_header_1_0(content, {"descr": "|O", "fortran_order": False, "shape": ()})  # type: ignore[no-untyped-call]
    return content.getvalue() + PICKLE


def _zarr(filters: list[dict[str, str]] | None, compressor: dict[str, str] | None, dtype: str) -> bytes:
    shape = [1, 4, 1, 1, 1]
    meta = {"zarr_format": 2, "shape": shape, "chunks": shape, "dtype": dtype, "fill_value": None, "order": "C"}
    about = json.dumps({**meta, "filters": filters, "compressor": compressor})
    return _zip({".zgroup": '{"zarr_format": 2}', "color/.zarray": about, "color/0.0.0.0.0": PICKLE})


_BOMB = "<!DOCTYPE l [<!ENTITY a 'lol'>{}]>".format(
    "".join(f"<!ENTITY {chr(98 + i)} '{f'&{chr(97 + i)};' * 10}'>" for i in range(10))
)
_FOREIGN = f"<!DOCTYPE s [<!ENTITY x SYSTEM 'file:///proc/self/environ'><!ENTITY y '${SECRET}'>]>"
_SCENES = (
    _BOMB + ROOM.replace('"mesh"', '"&k;"'),
    _BOMB + ROOM.replace("<film", "&k;<film"),
    _FOREIGN + ROOM.replace('"mesh"', '"&x;&y;"'),
    _FOREIGN.replace("ENTITY x", "ENTITY % x").replace("]>", "%x;]>") + ROOM,
    *(
        ROOM.replace("</scene>", f'<include filename="{name}"/></scene>')
        for name in ("/etc/passwd", "/proc/self/environ", "room.xml", "../../nothing.xml", "/etc", "/dev/zero")
    ),
    ROOM.replace("<sensor", '<path value="/etc"/><sensor'),
    ROOM.replace("</scene>", '<spectrum name="x" filename="/proc/self/environ"/></scene>'),
    "<scene version='3.0.0'>" + "<shape type='sphere'>" * 50_000,
    ROOM.replace("</scene>", "<bsdf type='twosided'>" * 20_000 + "</bsdf>" * 20_000 + "</scene>"),
    "<a " * 100_000,
    "<a x='" * 100_000,
    "<!--" * 100_000,
    ROOM.replace('"mesh"', '"&#xD800;&#27;"'),
    ROOM.replace('type="sphere"', f'type="../../{CANARY}"'),
)

_GROUP = "test: [{scene: rooms, clips: 1, frames: 3, reference_spp: 8}]"
_YAML = tuple(
    f"name: {value}\nseed: 3\n{_GROUP}\n".encode()  # a recipe; for all others an unknown key follows
    for value in (
        f"!!python/object/apply:os.system ['{RUN}']",
        f"!!python/object/apply:subprocess.check_call [[touch, {CANARY}]]",
        f"${{oc.env:{SECRET}}}",
        f"${{oc.decode:${{oc.env:{SECRET}}}}}",
    )
)

# name of a format → files in place of the one that its reader expects
STRANGERS: dict[str, tuple[bytes, ...]] = {
    **dict.fromkeys(("training", "comparison", "recipe", "animation", "channel map", "run"), _YAML),
    "scene": tuple(text.encode() for text in _SCENES),
    **dict.fromkeys(
        ("weights", "model", "noisebase", "TIFF", "cameras", "clip.json"),
        (
            PICKLE,
            _zip({"archive/data.pkl": PICKLE, "archive/version": "3\n"}),  # as torch.save writes
            _zip({"color.npy": _objects()}),
            _objects(),
        ),
    ),
}
STRANGERS["noisebase"] += (
    _zarr([{"id": "pickle"}], None, "|O"),
    _zarr([{"id": "vlen-utf8"}, {"id": "pickle"}], None, "|O"),
    _zarr(None, {"id": "pickle"}, "<f4"),
)
