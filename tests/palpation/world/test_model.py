"""A world by name or file: what is allowed is listed, and the paper's own is nothing at all."""

from pathlib import Path

import pytest

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.palpation.world.model import LAB, PAPER, WorldModel, basis, read_world, units


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "my.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_papers_world_is_all_zero_and_the_labs_has_everything_on() -> None:
    assert PAPER.plain
    assert set(PAPER.values().values()) == {0.0}
    assert not [name for name, value in LAB.values().items() if value == 0.0]
    assert (read_world("paper"), read_world("lab")) == (PAPER, LAB)


def test_every_parameter_has_a_unit_and_a_basis() -> None:
    assert set(basis()) == set(units()) == set(LAB.values())
    for name, words in basis().items():
        assert words.startswith(("assumed", "mechanics")), name
        assert f"\n        {name}: " in (WorldModel.__doc__ or ""), name


def test_a_file_changes_what_it_names(tmp_path: Path) -> None:
    path = written(tmp_path, "base: lab\nfriction_mounting_sd: 0.1\n")
    world = read_world(path)
    assert world.friction_mounting_sd == 0.1
    assert world.texture_sd_n_m == LAB.texture_sd_n_m
    assert world.name == str(path)
    assert read_world(written(tmp_path, "run_in: 1\n")).values() == {**PAPER.values(), "run_in": 1.0}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("base: lab\nfriction: 0.1\n", r":2:1: the world has no key 'friction'; "),
        ("base: moon\n", r":1:7: base must be paper or lab, not 'moon'"),
        (
            "base: lab\ntexture_sd_n_m: 0.2\n",
            r":2:17: texture_sd_n_m: 0.2 is not in \[0, 0.005\]; give it in N m",
        ),
        ("texture_sd_n_m: 1.0e-4\n", r"my.yaml:1:1: texture_length_m: a texture needs a correlation length"),
        ("run_in: 0.5\n", r":1:9: run_in: 0.5 is neither 0 nor 1"),
        ("modulus_batch_sd: much\n", r":1:19: modulus_batch_sd must be a number"),
        ("", "the file is empty"),
    ],
)
def test_a_wrong_file_is_refused_with_its_line_and_what_is_allowed(
    tmp_path: Path, text: str, words: str
) -> None:
    with pytest.raises(MechanicsError, match=words):
        read_world(written(tmp_path, text))


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(MechanicsError, match="no world 'labs'; use paper or lab"):
        read_world("labs")
    with pytest.raises(MechanicsError, match="cannot read the world"):
        read_world("none.yaml")


def test_a_value_that_is_no_number_is_refused_by_name() -> None:
    with pytest.raises(OutOfRange, match="modulus_batch_sd"):
        WorldModel(modulus_batch_sd=float("nan"))


def test_the_page_has_every_parameter_as_it_is() -> None:
    page = (
        Path(__file__).resolve().parents[3].joinpath("docs/explanation/world.md").read_text(encoding="utf-8")
    )
    for name, unit in units().items():
        assert f"| `{name}` | {unit} | {LAB.values()[name]:g} | {basis()[name]} |\n" in page
