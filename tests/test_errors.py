"""What errors say instead of a wrong name: the nearest one, also where it is typed in another case, and all of them."""

import pytest

from nte.errors import NteError, expected_one_of
from nte.filters.named import load_filter
from nte.frames.show import show
from nte.importing.channel_map import find_map
from nte.models.registry import network_type


def test_whatever_a_file_holds_an_error_is_one_line_of_printable_text() -> None:
    """Of a long one, where and what was found, and what was expected."""
    said = str(NteError(f"a.json: 'x\n\x1b[31m\u202e\ud800\u3000é' and {'y' * 10_000}, expected a number"))
    assert said.startswith("a.json: 'x\\n\\x1b[31m\\u202e\\ud800\u3000é' and yyy")
    assert said.endswith("yyy, expected a number")
    assert " … " in said
    assert len(said) < 1100
    said.encode()


NAMES = ("noisy", "taa", "svgf", "align_taa")


@pytest.mark.parametrize(
    ("found", "hint"),
    [
        ("tea", ", did you mean taa?"),
        ("SVGF", ", did you mean svgf?"),
        ("svfg", ", did you mean svgf?"),
        ("align-taa", ", did you mean align_taa?"),
        ("runs/mine", ","),
        ("", ","),
        (7, ","),
    ],
)
def test_the_nearest_name_comes_before_the_list(found: object, hint: str) -> None:
    assert expected_one_of(found, NAMES) == f"{hint} expected one of noisy, taa, svgf, align_taa"


def test_nothing_is_near_where_there_is_nothing() -> None:
    assert expected_one_of("tea", ()) == ", expected none"


def test_of_names_that_differ_in_case_alone_the_first_is_named() -> None:
    assert expected_one_of("zz.r", ("Z.R", "ZZ.R", "zz.R")).startswith(", did you mean ZZ.R?")


def test_a_name_is_listed_as_it_is_written() -> None:
    assert expected_one_of("beauty", ("Beauty", "Depth")) == ", did you mean Beauty? expected one of Beauty, Depth"


def test_mistyped_names_are_recognised_where_users_type_them() -> None:
    cases = {
        "'svfg:clamp=none' is no denoiser by name, did you mean svgf?": lambda: load_filter("svfg:clamp=none"),
        "'taa:aplha=0.2': unknown option 'aplha', did you mean alpha?": lambda: load_filter("taa:aplha=0.2"),
        "clamp is 'clmp', did you mean clamp?": lambda: load_filter("taa:clamp=clmp"),
        "preset is 'papper', did you mean paper?": lambda: load_filter("trmv:preset=papper"),
        "cannot show 'colour': no such channel, did you mean color?": lambda: show("colour", None),
        "--map blendr: neither a file nor a map that ships, did you mean blender?": lambda: find_map("blendr"),
        "'network.kind' is 'temproal', did you mean temporal?": lambda: network_type("temproal"),
    }
    for message, call in cases.items():
        with pytest.raises(NteError) as raised:
            call()
        assert message in str(raised.value)
