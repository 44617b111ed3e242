"""Recipes: what they draw, how they are read, and every fault named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vsgdesign.errors import StudyError
from vsgdesign.estimator.recipe_fields import check_recipe
from vsgdesign.estimator.recipes import CONTINUOUS, PUBLISHED, WINDOW_RECIPES
from vsgdesign.study.parameters.ranges import Spread, log_uniform, one_of, uniform

load_recipe, named_recipe = WINDOW_RECIPES.load, WINDOW_RECIPES.named


def test_draws_fill_their_spread() -> None:
    rng = np.random.default_rng(0)
    values = np.array([log_uniform(1.5, 24.0).draw(rng, k) for k in range(4000)])
    assert values.min() > 1.5
    assert values.max() < 24.0
    # Evenly in the logarithm: a quarter below 3; of 4000, within four standard deviations (0.027).
    assert np.mean(values < 3.0) == pytest.approx(0.25, abs=0.027)
    values = np.array([uniform(-1.0, 3.0).draw(rng, k) for k in range(4000)])
    assert np.mean(values < 0.0) == pytest.approx(0.25, abs=0.027)
    assert [one_of(1.0, 2.0, 3.0).draw(rng, k) for k in range(4)] == [1.0, 2.0, 3.0, 1.0]


@pytest.mark.parametrize("recipe", WINDOW_RECIPES.packaged.values(), ids=WINDOW_RECIPES.packaged)
def test_packaged_recipes_are_sound(recipe: Any) -> None:
    assert check_recipe(recipe) is recipe
    assert recipe.synchronised
    assert named_recipe(recipe.name) is load_recipe(recipe.name) is recipe


def test_unsynchronised_is_any_other_phase_or_frequency() -> None:
    assert not replace(PUBLISHED, phase=uniform(0.0, 6.0)).synchronised
    assert not replace(PUBLISHED, f_g_pu=one_of(1.0002)).synchronised


def test_a_file_replaces_fields_of_a_packaged_one(tmp_path: Path) -> None:
    path = tmp_path / "noisy.toml"
    path.write_text(
        'base = "published"\nscr = { log_uniform = [2, 20] }\nnoise_v = "0.5 %"\n'
        'phase = { uniform = ["0 deg", "90 deg"] }\nscenarios = 40\nsample_interval = "100 us"\nsamples = 200\n'
        'bridge = "averaged"\n'
    )
    expected = replace(
        PUBLISHED,
        name="noisy",
        scr=log_uniform(2.0, 20.0),
        noise_v=one_of(0.005),
        phase=uniform(0.0, np.pi / 2.0),
        scenarios=40,
        sample_interval=100e-6,
        samples=200,
        bridge="averaged",
    )
    found = load_recipe(path)
    assert found.phase.values == pytest.approx(expected.phase.values)
    assert replace(found, phase=expected.phase) == expected


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("scr = { uniform = [9, 2] }", r"scr.uniform = \[9, 2\]: the range is reversed"),
        ("scr = { uniform = [nan, 2] }", r"scr.uniform\[0\] = nan: must be a finite number"),
        ('P_pu = "3 kW"', 'P_pu = "3 kW": expected'),
        ('scr = "2 Hz"', 'scr = "2 Hz": expected'),
        ("scr = { between = [1, 2] }", r"expected a number or \{ one_of \| uniform \| log_uniform"),
        ("scr = { one_of = [] }", "scr.one_of = .*: must be a list of at least one value"),
        ("scr = [1, 2]", "scr = "),
        ("x_over_r = { uniform = [0, 2] }", r"x_over_r.uniform\[0\] = 0: outside 0.001 to 10000"),
        ("P_pu = { log_uniform = [-1, 2] }", "P_pu.log_uniform = .*: a logarithmic range must be positive"),
        ("noise_v = 2", "noise_v = 2: outside 0 to 1"),
        ("harmonic_5 = -0.1", "harmonic_5 = -0.1: outside 0 to 0.5"),
        ("scenarios = 0", "scenarios = 0: must be a whole number from 1"),
        ("scenarios = 2.5", "scenarios = 2.5: must be a whole number"),
        ("before = 0\nafter = 0", "no window is kept"),
        (
            "samples = 3",
            "samples = 3: must be a whole number from 4 to 10000. Or give 0: it follows from the converter",
        ),
        ('sample_interval = "1 s"', "outside 1 us to 100 ms .*Or give 0: it follows from the converter"),
        ('channels = "abc"', 'channels = "abc": must be one of "phase_a", "alpha_beta", "dq"'),
        ("bridge = 1", 'bridge = 1: must be one of "averaged"'),
        ("grid_step_share = 1.5", "grid_step_share = 1.5: outside 0 to 1"),
        ("sample_intervall = 1", r"sample_intervall: unknown field. Did you mean sample_interval\?"),
        ('base = "publisched"', 'base = "publisched": unknown. Did you mean published'),
        ("= 1", "cannot be read"),
    ],
)
def test_every_fault_is_named(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "recipe.toml"
    path.write_text(text)
    with pytest.raises(StudyError, match=problem):
        load_recipe(path)


def test_all_faults_at_once(tmp_path: Path) -> None:
    path = tmp_path / "recipe.toml"
    path.write_text('scr = { uniform = [9, 2] }\nscenarios = -1\nbridge = "ideal"\n')
    with pytest.raises(StudyError) as caught:
        load_recipe(path)
    assert [fault.field for fault in caught.value.faults] == ["scr.uniform", "scenarios", "bridge"]


def test_unknown_names_and_missing_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r'"continous": unknown\. Did you mean continuous\?.*Known: published'):
        named_recipe("continous")
    with pytest.raises(StudyError, match="there is no such file"):
        load_recipe(tmp_path / "none.toml")
    with pytest.raises(StudyError, match=r"scr = .*: expected a number or \{ one_of"):
        check_recipe(replace(CONTINUOUS, scr=Spread("normal", (1.0, 2.0))))
