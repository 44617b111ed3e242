"""The levels that the verbs name are the packaged ones."""

from vsgdesign.study.parameters import background, sensors
from vsgdesign.verbs.cli.estimator import BACKGROUNDS, SENSORS


def test_the_verbs_name_every_packaged_level() -> None:
    assert tuple(background.LEVELS) == BACKGROUNDS
    assert tuple(sensors.LEVELS) == SENSORS
