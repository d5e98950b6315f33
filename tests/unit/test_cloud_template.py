"""The tracker `cloud_template`: a template that keeps its lengths follows the cloud, and goes on where it is hidden."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from test_depth_mesh import SIZE, TIME, bent, filmed

from clothbench import ClothbenchError
from clothbench.plugins.discovery import catalogue


def tracker(**options):
    return catalogue().make("trackers", "cloud_template", **options)


def test_it_follows_a_bent_sheet_and_keeps_its_lengths():
    seen = tracker().track(filmed())
    truth = np.stack([bent(seen.material, t) for t in seen.time])
    away = np.linalg.norm(seen.position - truth, axis=-1)
    assert np.isfinite(away).mean() > 0.95
    assert np.nanmedian(away) < 4e-3
    nodes = seen.position.reshape(len(TIME), 9, 9, 3)
    for axis, step in ((2, SIZE[0] / 8), (1, SIZE[1] / 8)):
        length = np.linalg.norm(np.diff(nodes, axis=axis), axis=-1)
        assert np.sqrt(np.nanmean((length / step - 1) ** 2)) < 0.02


def test_what_something_hides_later_keeps_its_labels():
    clear, hidden = filmed(), filmed(hidden=0.3)
    depth, colour = np.array(hidden.depth), np.array(hidden.colour.frame)
    depth[:2], colour[:2] = clear.depth[:2], clear.colour.frame[:2]
    images = dataclasses.replace(hidden, depth=depth, colour=dataclasses.replace(hidden.colour, frame=colour))
    seen = tracker().track(images)
    truth = np.stack([bent(seen.material, t) for t in seen.time])
    away = np.linalg.norm(seen.position - truth, axis=-1)
    behind = seen.material[:, 0] > 0.9 * SIZE[0]
    assert np.isfinite(away[:2, behind]).mean() > 0.8
    assert np.isnan(away[2:, behind]).all()
    assert np.nanmedian(away[2:]) < 4e-3


def test_the_cloths_hue_is_asked_for_once(monkeypatch):
    """It looks at several frames, and is the same for all of them."""
    follower, asked = tracker(mesh=(3, 3), rounds=1), []
    cleaner = type(follower.cleaner)
    own = cleaner.hue_of
    monkeypatch.setattr(cleaner, "hue_of", lambda self, images: asked.append(images) or own(self, images))
    assert follower.track(filmed()).visible.any()
    assert len(asked) == 1


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({"refine": 0}, "cloud_template: refine is 0, expected a whole number"),
        ({"rounds": 2.5}, "cloud_template: rounds is 2.5, expected a whole number"),
        ({"reach": -1}, "cloud_template: reach is -1, expected a number above 0"),
        ({"sigma": "small"}, "cloud_template: sigma is 'small', expected metres above 0, or null"),
        ({"foo": 1}, "cloud_template: 'foo' is no option of it"),
        ({"jump": 0}, "jump is 0, expected a number above 0"),
    ],
)
def test_bad_options_are_refused(options, found):
    with pytest.raises(ClothbenchError) as caught:
        tracker(**options)
    assert found in str(caught.value)


def test_a_sheet_that_is_never_whole_is_refused():
    with pytest.raises(ClothbenchError, match="found no frame that shows 90% of the sheet"):
        tracker().track(filmed(hidden=0.4))
