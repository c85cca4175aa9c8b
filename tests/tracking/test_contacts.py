"""Feet that stand: found where they stand, held there, and not where they do not."""

import numpy as np
import pytest

from hypose.tracking.smoothing import Contacts, ContactSettings, find_contacts, sliding

RATE = 25.0


def walking_points(steps=3, floor=0.1):
    """(T, 4, 3): each foot stands for 0.4 s and swings for 0.4 s, in turn."""
    t = np.arange(int(0.8 * RATE * steps)) / RATE
    out = np.zeros((len(t), 4, 3))
    for foot, phase in ((0, 0.0), (1, 0.4)):
        cycle, inside = np.divmod(t + phase, 0.8)
        swing = np.clip((inside - 0.4) / 0.4, 0, 1)
        smooth = swing**2 * (3 - 2 * swing)
        for k in (2 * foot, 2 * foot + 1):
            out[:, k, 0] = 1.2 * (cycle + smooth) + 0.1 * (k % 2)
            out[:, k, 2] = floor + 0.12 * np.sin(np.pi * swing)
    return out


def test_contacts_are_where_feet_stand():
    points = walking_points()
    contacts = find_contacts(points, np.ones(len(points), bool), RATE)
    assert contacts.floor == pytest.approx(0.1, abs=0.01)
    moving = np.linalg.norm(np.gradient(points, 1 / RATE, axis=0), axis=-1) > 0.8
    assert not (contacts.touching & moving).any()
    assert 0.3 < contacts.touching.mean() < 0.7
    assert np.isfinite(contacts.place[contacts.touching]).all()
    assert np.isnan(contacts.place[~contacts.touching]).all()


def test_no_contact_in_unknown_frames_nor_in_the_air():
    points = walking_points()
    known = np.ones(len(points), bool)
    known[10:40] = False
    assert not find_contacts(points, known, RATE).touching[10:40].any()
    hovering = points.copy()
    hovering[:, :2] = [5.0, 0.0, 0.8]  # one foot is held up, quite still
    found = find_contacts(hovering, np.ones(len(points), bool), RATE)
    assert np.isnan(found.floor)  # which foot is on the ground cannot be told; holding a still one still does no harm
    low = find_contacts(hovering, np.ones(len(points), bool), RATE, ContactSettings(common=0.2))
    assert low.floor == pytest.approx(0.1, abs=0.01)
    assert not low.touching[:, :2].any() and low.touching[:, 2:].any()


def test_sliding_is_measured():
    t = 20
    place = np.zeros((t, 4, 3))
    contacts = Contacts(np.ones((t, 4), bool), place, 0.0)
    points = place.copy()
    points[..., 0] = 0.1 * np.arange(t)[:, None] / RATE  # 0.1 m/s
    assert sliding(points, contacts, RATE) == pytest.approx(100)
