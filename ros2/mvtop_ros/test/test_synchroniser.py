import threading

import pytest
from mvtop_ros.finder import BusyError, Finder
from mvtop_ros.synchroniser import Synchroniser


def made(**changed):
    values = {"slop_s": 0.04, "min_cameras": 2, "silent_after_s": 1.0} | changed
    return Synchroniser(["a", "b", "c"], **values)


def fed(synchroniser, *images):
    """The exposures that (camera, stamp, now) make; messages are camera and stamp."""
    given = [synchroniser.add(camera, stamp, now, (camera, stamp)) for camera, stamp, now in images]
    return [(one.stamp_s, [stamp for _, stamp in one.messages.values()]) for one in given if one]


def test_images_of_one_moment_make_an_exposure():
    images = [("a", 5.0, 0.0), ("b", 5.01, 0.01), ("c", 5.03, 0.02)]
    assert fed(made(), *images) == [(5.03, [5.0, 5.01, 5.03])]


def test_images_of_different_moments_make_none():
    images = [("a", 5.0, 0.0), ("b", 5.05, 0.0), ("c", 5.06, 0.0), ("a", 5.07, 0.0)]
    assert fed(made(), *images) == [(5.07, [5.07, 5.05, 5.06])]
    # Each near the last one, but not near each other.
    assert fed(made(), ("a", 5.0, 0), ("b", 5.06, 0), ("c", 5.03, 0)) == []


def test_images_are_used_once():
    exposures = fed(
        made(),
        ("a", 1.0, 0.0), ("b", 1.0, 0.0), ("c", 1.0, 0.0), ("a", 1.01, 0.1), ("b", 1.01, 0.1),
        ("c", 1.02, 0.1),
    )  # fmt: skip
    assert exposures == [(1.0, [1.0, 1.0, 1.0]), (1.02, [1.01, 1.01, 1.02])]


def test_camera_that_stops_is_waited_for_only_so_long():
    synchroniser = made()
    assert len(fed(synchroniser, ("a", 1, 1), ("b", 1, 1), ("c", 1, 1))) == 1
    assert fed(synchroniser, ("a", 2, 2), ("b", 2, 2)) == []
    assert fed(synchroniser, ("a", 3, 2.9), ("b", 3, 2.9)) == []
    assert fed(synchroniser, ("a", 4, 3.1), ("b", 4, 3.1)) == [(4, [4, 4])]
    assert synchroniser.missing(3.1) == ["c"] and synchroniser.silent(3.1) == ["c"]
    # It comes again.
    assert fed(synchroniser, ("c", 5, 3.2), ("a", 5, 3.2), ("b", 5, 3.2)) == [(5, [5, 5, 5])]


def test_camera_that_never_came_is_waited_for_only_so_long():
    synchroniser = made()
    assert fed(synchroniser, ("a", 1, 0), ("b", 1, 0)) == []
    assert fed(synchroniser, ("a", 2, 1.1), ("b", 2, 1.1)) == [(2, [2, 2])]


def test_pauses_between_exposures_make_no_camera_missing():
    synchroniser = made()
    for now in (0, 100, 200):
        given = [(camera, now, now) for camera in "cab"]
        assert fed(synchroniser, *given) == [(now, [now] * 3)]
        assert synchroniser.missing(now + 50) == []
        assert synchroniser.silent(now + 50) == ["a", "b", "c"]


def test_images_that_wait_are_done_without_the_missing_one_though_none_come_any_more():
    synchroniser = made()
    assert fed(synchroniser, ("a", 7, 0), ("b", 7, 0)) == []
    assert synchroniser.poll(0.9) is None
    exposure = synchroniser.poll(1.1)
    assert list(exposure.messages) == ["a", "b"]
    assert synchroniser.poll(2.0) is None


def test_fewer_cameras_than_asked_for_make_none():
    synchroniser = made(min_cameras=3)
    assert fed(synchroniser, ("a", 1, 0), ("b", 1, 0), ("a", 9, 9), ("b", 9, 9)) == []


def test_time_that_begins_anew_does_not_stop_it():
    synchroniser = made()
    images = [("a", 100, 0), ("b", 100, 0), ("c", 90, 0)]
    assert fed(synchroniser, *images) == []
    assert fed(synchroniser, ("a", 1, 1), ("b", 1, 1), ("c", 1, 1)) == [(1, [1, 1, 1])]


def test_one_more_than_may_wait_is_turned_away():
    began, go_on = threading.Event(), threading.Event()

    class Slow:
        def predict(self, images, rig, *, request, tracks):
            began.set()
            assert go_on.wait(10)
            return images

    finder, found = Finder(Slow(), waiting=1), []
    threads = [
        threading.Thread(target=lambda n=n: found.append(finder.find(n, None, None)))
        for n in range(2)
    ]
    threads[0].start()
    assert began.wait(10)
    threads[1].start()
    while finder._places._value:
        pass
    with pytest.raises(BusyError, match="expected 1 waiting requests at most"):
        finder.find(2, None, None)
    go_on.set()
    for thread in threads:
        thread.join(10)
    assert sorted(found) == [0, 1]
    assert finder.find(3, None, None) == 3
