"""View transforms: the curves that they are, OpenColorIO's in the right colour space, and names that are not there."""

import sys

import numpy as np
import pytest

from nte.errors import NteError
from nte.frames.show import display
from nte.frames.views import find_view

COLOURED = np.array([[0.5, 0.0, 0.02], [0.1, 0.7, 0.3]], np.float32).T.reshape(3, 1, 2)


def test_standard_is_the_srgb_curve_of_light_times_exposure_and_cuts_off_at_one() -> None:
    light = np.array([0.0, 0.001, 0.25, 0.5, 0.6, 40.0], np.float32).reshape(1, 1, 6).repeat(3, 0)
    expected = [0, 12.92 * 0.002, 1.055 * 0.5 ** (1 / 2.4) - 0.055, 1, 1, 1]
    np.testing.assert_allclose(find_view("standard")(light, 2.0)[1, 0], expected, atol=1e-6)


def test_the_default_is_how_reports_show_light() -> None:
    light = np.random.default_rng(0).exponential(size=(3, 5, 7)).astype(np.float32)
    np.testing.assert_array_equal(find_view("nte")(light, 0.3), display(light, 0.3))


def test_a_view_of_opencolorio_takes_light_of_rec709(monkeypatch: pytest.MonkeyPatch) -> None:
    # The scene-linear space of this configuration is ACEScg: red light of Rec. 709 would come out with green in it.
    monkeypatch.delenv("OCIO", raising=False)
    shown = find_view("UN-tone-mapped")(COLOURED, 1.0)
    np.testing.assert_allclose(shown, find_view("standard")(COLOURED, 1.0), atol=2e-3)
    brighter = find_view("Un-tone-mapped")(COLOURED, 1.5)
    np.testing.assert_allclose(brighter, find_view("standard")(COLOURED * 1.5, 1.0), atol=2e-3)


def test_the_light_that_a_view_is_given_stays_what_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OCIO", raising=False)
    for name in ("nte", "standard", "Un-tone-mapped"):
        light = np.ascontiguousarray(COLOURED)
        find_view(name)(light, 1.0)
        np.testing.assert_array_equal(light, COLOURED)


def test_the_configuration_is_the_one_that_ocio_names(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    import PyOpenColorIO

    config = PyOpenColorIO.Config.CreateRaw()
    config.addColorSpace(PyOpenColorIO.ColorSpace(name="Linear Rec.709"))
    half = PyOpenColorIO.MatrixTransform(matrix=np.diag([0.5, 0.5, 0.5, 1.0]).ravel().tolist())
    dark = PyOpenColorIO.ColorSpace(name="dark", fromReference=half)
    config.addColorSpace(dark)
    config.addDisplayView("monitor", "Dark Room", "dark")
    config.setActiveDisplays("monitor")
    path = tmp_path / "config.ocio"
    path.write_text(config.serialize())
    monkeypatch.setenv("OCIO", str(path))
    np.testing.assert_allclose(find_view("dark room")(COLOURED, 1.0), COLOURED / 2, atol=1e-6)
    with pytest.raises(NteError, match=r"no view 'agx' in .*config\.ocio, which has Dark Room; nte has nte, standard"):
        find_view("agx")


def test_a_configuration_that_cannot_be_read_is_named(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    for text in ("", "no: configuration", "ocio_profile_version: 2\nroles: [broken\n"):
        path = tmp_path / "config.ocio"
        path.write_text(text)
        monkeypatch.setenv("OCIO", str(path))
        with pytest.raises(NteError, match=r"config\.ocio: OpenColorIO cannot use it: ") as raised:
            find_view("agx")
        assert "\n" not in str(raised.value)
    monkeypatch.setenv("OCIO", str(tmp_path / "lost.ocio"))
    with pytest.raises(NteError, match=r"lost\.ocio: OpenColorIO cannot use it"):
        find_view("agx")


def test_without_opencolorio_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "PyOpenColorIO", None)
    find_view("standard")
    with pytest.raises(NteError, match=r"the view 'AgX' needs the package 'PyOpenColorIO': .*\[view\]"):
        find_view("AgX")
