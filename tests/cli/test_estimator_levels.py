"""The levels that the verbs name are the packaged ones."""

from vsgdesign.cli.estimator import BACKGROUNDS, SENSORS
from vsgdesign.parameters import background, sensors


def test_the_verbs_name_every_packaged_level() -> None:
    assert tuple(background.LEVELS) == BACKGROUNDS
    assert tuple(sensors.LEVELS) == SENSORS
