"""The schemas of scene and phantom files: they take what the checker takes, and refuse what it refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.mechanics.scene.schema import phantoms_schema, scene_schema
from tests.support.palp import ROOT, Palp

READERS: dict[str, Any] = {
    "scene": (scene_schema, lambda file: read_scene(file)),
    "phantoms": (phantoms_schema, lambda file: load_phantoms(str(file))),
}


@pytest.mark.parametrize(("kind", "words"), [("scene", ()), ("phantoms", ("--phantoms",))])
def test_the_kept_one_is_what_palp_prints(palp: Palp, kind: str, words: tuple[str, ...]) -> None:
    kept = ROOT / "launch" / f"{kind}.schema.json"
    printed = palp.here("scene", "schema", *words)
    assert json.loads(printed.stdout) == READERS[kind][0]()
    command = " ".join(["palp scene schema", *words])
    assert kept.read_text(encoding="utf-8") == printed.stdout, f"{command} > {kept.relative_to(ROOT)}"
    jsonschema.Draft7Validator.check_schema(READERS[kind][0]())


@pytest.mark.parametrize(
    ("kind", "text", "fits"),
    [
        ("scene", "ring_m: 0.008", True),
        ("scene", "ring_m: [0.004, 0.016]", True),
        ("scene", "phantom: {modulus_pa: 40000.0, bead: {depth_m: 0.002}}", True),
        ("scene", "phantom: {bead: none}", True),
        (
            "scene",
            "tolerance: {output: peak, relative: 0.02, strain: finite, depths_m: [0.002, 0.004]}",
            True,
        ),
        ("scene", "path: {indentation_m: 0.003}", True),
        ("scene", "budget_s: 3.0", True),
        ("scene", "rings_m: 0.008", False),
        ("scene", "phantom: {modulus: 40000.0}", False),
        ("scene", "phantom: {modulus_pa: 0.0}", False),
        ("scene", "phantom: {poisson: 0.6}", False),
        ("scene", "phantom: {bead: {radius_m: 0.005}}", False),
        ("scene", "phantom: {bead: nothing}", False),
        ("scene", "tolerance: {output: peaks}", False),
        ("scene", "ring_m: stiff", False),
        ("scene", "probe: 3", False),
        ("phantoms", "A: {bead: {depth_m: 0.002}}\nbare: {bead: none}", True),
        ("phantoms", "A: {bead: {depth: 0.002}}", False),
        ("phantoms", "A: 3", False),
        ("phantoms", "{}", False),
    ],
)
def test_it_judges_as_the_checker_does(tmp_path: Path, kind: str, text: str, *, fits: bool) -> None:
    schema, read = READERS[kind]
    file = tmp_path / "given.yaml"
    file.write_text(text)
    assert jsonschema.Draft7Validator(schema()).is_valid(yaml.safe_load(text)) is fits
    if fits:
        read(file)
    else:
        with pytest.raises(MechanicsError):
            read(file)
