import numpy as np

from tfg_drake.slam.tag_error import FIRST, in_place, learnt, suspected

DEVIATION = np.array([0.02, 0.005])


def test_where_a_tag_seems_to_be():
    """Along the line of sight by the error of range, across it by that of bearing times the distance."""
    ahead, aside = in_place(np.array([[4.0, 0.0], [0.0, 4.0]]), DEVIATION)
    np.testing.assert_allclose(ahead, np.diag([0.02, 4.0 * 0.005]) ** 2)
    np.testing.assert_allclose(aside, np.diag([4.0 * 0.005, 0.02]) ** 2)


def test_pulls_by_noise_are_not_suspicious():
    rng = np.random.default_rng(1)
    variance = rng.uniform(1e3, 1e5, (60, 2))
    pull = np.sqrt(variance) * rng.normal(size=(60, 2))
    assert not suspected(pull, variance).any()
    np.testing.assert_array_equal(suspected(2.0 * pull, variance), FIRST)
    assert not suspected(9.0 * pull[:9], variance[:9]).any()


def test_deviations_are_found_and_lost():
    """Of errors that are estimated each with a noise of its own."""
    rng = np.random.default_rng(2)
    noise = np.array([0.01, 0.002])
    seen = DEVIATION * rng.normal(size=(400, 2)) + noise * rng.normal(size=(400, 2))
    found = np.array(FIRST)
    for _ in range(20):
        share = found**2 / (found**2 + noise**2)
        found = learnt(found, share * seen, np.tile(found**2 * (1.0 - share), (400, 1)))
    np.testing.assert_allclose(found, DEVIATION, rtol=0.1)
    assert not learnt(np.array([1e-3, 3e-4]), np.full((50, 2), 1e-5), np.zeros((50, 2))).any()
