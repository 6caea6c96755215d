"""Scan matching: motion between scans, and its comparison with odometry.

Two scans determine the robot's motion between them, as the points of one lie on the surfaces that the other saw; so
does odometry. Where the two differ by a constant factor, clock lag or mount angle, that can be corrected; where they
turn in opposite directions, either may be right.
"""

from __future__ import annotations

import bisect
import dataclasses
import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, LaserScan, Odometry, TagDetections, message, replace
from tfg_drake.notes import Note
from tfg_drake.slam.scan_matching_kernels import fitting, normals, searched

# A finer scan is thinned to RAYS rays; with fewer than FEWEST there is no match.
RAYS, FEWEST = 360, 20
# A match needs the share SHARE of the rays in view of both scans. It is ambiguous if a pose that is more than DISTINCT
# deviations away reaches the share RIVAL of its score.
SHARE, RIVAL, DISTINCT = 0.5, 0.93, 6.0
# Covariance of a match: that of independent rays times COMMON, as neighbours have common errors, plus the variances of
# LEAST, m, m, rad; directions that the scans do not determine have MOST, m.
COMMON, LEAST, MOST = 4.0, (0.002, 0.002, 0.0007), 10.0

# Matches whose heading has a greater deviation, rad, are not used: their position is no Gaussian.
MOST_DEVIATION = 0.1

# The scans of a pair are at least APART and less than TOO_FAR apart, s: after half a metre other places fit.
APART, TOO_FAR = 0.35, 0.8
# Clock lags are searched up to MOST_LAG, s, either way, in steps of LAG_STEP, s.
MOST_LAG, LAG_STEP = 1.2, 0.04
# The lag is fitted to at most this number of pairs.
MOST_PAIRS = 1000
# Deviations of the odometry within APART: of a turn (rad), of a distance (m), and as a share of either.
TURN_ERROR, WAY_ERROR, SHARE_ERROR = 0.006, 0.008, 0.02
# Residuals beyond this many deviations are downweighted (Cauchy).
ROBUST = 2.5
# Prior information of the distance's complex factor and of the scanner's lever arm, which is some 0.2 m.
LEVER_PRIOR = np.array([1e-6, 1e-6, 0.2**-2, 0.2**-2])
# A pair moves if either sensor shows more than this, m and rad. A value beyond SURELY deviations is significant.
MOVES, SURELY = (0.05, 0.05), 5.0
# A pair contradicts the odometry only if the two differ by this much, m or rad.
CONTRADICTS = (0.1, 0.1)
# Contradictions within this time of each other, s, are one stretch.
ONE_STRETCH = 1.0
# At least PAIRS moving pairs are needed for a verdict; if less than the share EXPLAINED of them fits, odometry and
# scans contradict each other. A factor is corrected if TELL moving pairs fit.
PAIRS, EXPLAINED, TELL = 12, 0.5, 5
# Smaller errors of scales, lag (s) and yaw (rad) are learnt with the map. A scale beyond MOST_SCALE is a wrong unit.
LEAST_SCALE, LEAST_LAG, LEAST_YAW, MOST_SCALE = 0.07, 0.03, 0.1, 6.0
# Scans, or frames of tags.
View = TypeVar("View", LaserScan, TagDetections)
AGAINST = "scans turn against the odometry"

# While the robot drives, a pair of scans is compared with odometry every EVERY, s; LONG consecutive contradictions are
# reported. KEPT odometry messages are kept for that.
EVERY, LONG, KEPT = 2.0, 4, 128


@message
class Matched:
    """A match of two scans. X: (3,) the pose of the body at the second scan in the body at the first. covariance: (3,
    3) of X, large in directions that the scans do not determine. share: of the rays in view of both, those that fit."""

    X: FloatArray
    covariance: FloatArray
    share: float


def match(before: LaserScan, after: LaserScan, X_guess: FloatArray | None = None) -> Matched | None:
    """Return the motion of the body between two scans: the points of `after` are fitted to the surfaces of `before`,
    from the guess (3,), which may be off by half a metre and a radian. None if too few rays fit, or as many
    elsewhere."""
    return _matched(surface(before), surface(after), np.zeros(3) if X_guess is None else X_guess)


def surface(scan: LaserScan) -> FloatArray:
    """Return the rays (n, 6) of a scan that hit a surface, see `tfg_drake.slam.scan_matching_kernels`."""
    met = (scan.ranges > 0.0) & (scan.ranges < np.inf)
    r = scan.ranges[met]
    bend = float(np.median(np.abs(np.diff(r, 2)))) / 1.65 if len(r) > FEWEST else 0.0
    sigma = min(max(bend, scan.sigma, 0.003), 0.05)
    return np.asarray(normals(scan.angles[met], r, sigma, max(1, math.ceil(len(r) / RAYS))))


def _matched(before: FloatArray, after: FloatArray, X_guess: FloatArray) -> Matched | None:
    if min(len(before), len(after)) < FEWEST:
        return None
    X, score, H, F, X_rival, rival, share = searched(before, after, np.array(X_guess, dtype=float))
    values, vectors = np.linalg.eigh(H - 2.0 * F)
    covariance = (vectors / np.maximum(values / COMMON, MOST**-2)) @ vectors.T + np.diag(np.square(LEAST))
    apart = X_rival - X
    apart[2] = se2.wrap_angle(apart[2])
    is_distinct = apart @ np.linalg.solve(covariance, apart) > DISTINCT**2
    if share < SHARE or (rival > RIVAL * score and is_distinct):
        return None
    return Matched(X, covariance, float(share))


@message
class Comparison:
    """Comparison of odometry with scans, over n pairs of consecutive scans.

    begun: s, start of the first pair by the scans' clock. turn, travel: ratio of the scans' turns and distances to the
    odometry's. lag: s, offset of the scans' clock ahead of the odometry's. yaw: rad, yaw of the scanner to the left of
    its stated one. deviations: (4,) of turn, travel, lag and yaw, inf if undetermined. contradicts: (k, 2) intervals,
    s by the scans' clock, in which the odometry, corrected, contradicts the scans. turning, travelling: (2,) each,
    number of pairs with a turn or motion by either, and number of these that are explained. stands: True if the
    odometry never moves.
    """

    mount_known: bool
    begun: float
    contradicts: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((0, 2)))
    turn: float = 1.0
    travel: float = 1.0
    lag: float = 0.0
    yaw: float = 0.0
    deviations: FloatArray = dataclasses.field(default_factory=lambda: np.full(4, np.inf))
    turning: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(2))
    travelling: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(2))
    stands: bool = False


@message
class Verdict:
    """Corrections: the odometry's increments by the factors turn and travel, the scans' stamps by lag, s, and their
    bearings by yaw, rad. notes: one for each of these. refusal: the reason why odometry and scans are unusable
    together, one line, or "". against: True if the reason is that the scans turn the other way."""

    turn: float = 1.0
    travel: float = 1.0
    lag: float = 0.0
    yaw: float = 0.0
    notes: tuple[Note, ...] = ()
    refusal: str = ""
    against: bool = False

    @property
    def lines(self) -> list[str]:
        """Return one line for each fault that the user can fix."""
        return [self.refusal] if self.refusal else [note.text for note in self.notes]


class _Way:
    """Odometry, interpolated at any time."""

    def __init__(self, odometry: Sequence[Odometry]) -> None:
        self.stamps = np.array([one.stamp for one in odometry])
        X = np.array([one.X_OB for one in odometry])
        self._p, self._heading = X[:, 0] + 1j * X[:, 1], np.unwrap(X[:, 2])
        unknown = np.flatnonzero(np.diff([one.breaks for one in odometry]))
        self._lost, self._found = self.stamps[unknown], self.stamps[unknown + 1]

    def tells(self, begin: FloatArray, end: FloatArray) -> BoolArray:
        """Return a mask (n,) of the intervals from begin to end (n,), s, in which the motion is known."""
        lost = np.searchsorted(self._lost, end) > np.searchsorted(self._found, begin, "right")
        return np.asarray((self.stamps[0] <= begin) & (end <= self.stamps[-1]) & ~lost)

    def moved(self, begin: FloatArray, end: FloatArray) -> tuple[NDArray[np.complex128], FloatArray]:
        """Return the motion from begin to end, each (n,), s: chord (n,), m, as complex numbers, ahead and i times to
        the left in the heading at half the turn, and turn (n,), rad."""
        p, q = (np.interp(at, self.stamps, self._p) for at in (begin, end))
        before, after = (np.interp(at, self.stamps, self._heading) for at in (begin, end))
        return (q - p) * np.exp(-0.5j * (before + after)), np.asarray(after - before, dtype=float)


@message
class _Robust:
    """Least squares with outliers: x (k,), information (k, k), off (n,) deviations, cost."""

    x: FloatArray
    information: FloatArray
    off: FloatArray
    cost: float


def _robust(A: FloatArray, y: FloatArray, prior: FloatArray) -> _Robust:
    """Solve robust least squares A x = y of A (n, d, k), y (n, d), whitened, with prior information (k,) about x =
    0."""
    weight = np.ones(len(y))
    for bound in (8.0, 4.0, ROBUST, ROBUST, ROBUST, ROBUST):
        information = np.einsum("n,nda,ndb->ab", weight, A, A) + np.diag(prior)
        x = np.linalg.solve(information, np.einsum("n,nda,nd->a", weight, A, y))
        off = np.sqrt(((y - A @ x) ** 2).sum(axis=1))
        weight = 1.0 / (1.0 + (off / bound) ** 2)
    return _Robust(x, information, off, float(ROBUST**2 * np.log1p((off / ROBUST) ** 2).sum()))


@message
class Pairs:
    """n pairs of scans, or of frames of tags, to be compared with odometry. begin, end: (n,) s, of their clock. X: (n,
    3) motion between them, and covariance: (n, 3, 3), nan if they do not match."""

    begin: FloatArray
    end: FloatArray
    X: FloatArray
    covariance: FloatArray

    def of(self, which: NDArray[np.integer]) -> Pairs:
        """Return some of the pairs."""
        return Pairs(self.begin[which], self.end[which], self.X[which], self.covariance[which])

    def fits(self, way: _Way, lag: float) -> tuple[_Robust, _Robust, FloatArray]:
        """Fit turns and distances for a lag, s, of the scans' clock: x is the factor (1,) of the turn; and (4,) real
        and imaginary part of the distance's factor and of the scanner's lever arm, m. Returns also the motions X (n, 3)
        predicted by these."""
        chord, turned = way.moved(self.begin - lag, self.end - lag)
        turn = self.X[:, 2]
        scale = 1.0 / np.sqrt(self.covariance[:, 2, 2] + TURN_ERROR**2 + (SHARE_ERROR * turn) ** 2)
        of_turn = _robust((turned * scale)[:, None, None], (turn * scale)[:, None], np.array([1e-6]))
        p, q = chord * np.exp(0.5j * turn), np.exp(1j * turn) - 1.0
        A = np.array([[p.real, -p.imag, q.real, -q.imag], [p.imag, p.real, q.imag, q.real]]).transpose(2, 0, 1)
        square = WAY_ERROR**2 + SHARE_ERROR**2 * (self.X[:, :2] ** 2).sum(axis=1)
        spread = self.covariance[:, :2, :2] + square[:, None, None] * np.eye(2)
        whitened = np.linalg.inv(np.linalg.cholesky(spread))
        of_way = _robust(whitened @ A, (whitened @ self.X[:, :2, None])[:, :, 0], LEVER_PRIOR)
        return of_turn, of_way, np.column_stack([A @ of_way.x, turned * of_turn.x[0]])

    def cost(self, way: _Way, lag: float) -> float:
        """Return the robust cost of all pairs at a lag, s."""
        return sum(fit.cost for fit in self.fits(way, lag)[:2])

    def lag(self, way: _Way) -> tuple[float, float]:
        """Return the best lag, 0 if that fits as well, and its deviation, s."""
        lag, step = 0.0, LAG_STEP
        for reach in (round(MOST_LAG / LAG_STEP), 4, 4):
            lags = lag + step * np.arange(-reach, reach + 1)
            lag = float(lags[int(np.argmin([self.cost(way, one) for one in lags]))])
            step *= 0.25
        of_turn, of_way, _ = self.fits(way, lag)
        if self.cost(way, 0.0) - of_turn.cost - of_way.cost < (SURELY * _scatter(of_turn, of_way)) ** 2:
            lag = 0.0
        h = 1.5 * LAG_STEP
        bend = (self.cost(way, lag - h) - 2.0 * self.cost(way, lag) + self.cost(way, lag + h)) / h**2
        return lag, math.sqrt(2.0 / bend) if bend > 0.0 else math.inf


def compare(odometry: Sequence[Odometry], scans: Sequence[LaserScan], mount_known: bool) -> Comparison:
    """Compare odometry with scans, both in the order of their stamps. mount_known: True if the bearings of the scans
    are in the body frame; otherwise they may be in the scanner's."""
    chosen = apart(scans)
    return compared(odometry, _ways(chosen), mount_known, chosen)


def apart(views: Sequence[View]) -> list[View]:
    """Return the views, in the order of their stamps, that are APART from the previous one."""
    chosen = list(views[:1])
    for view in views[1:]:
        if view.stamp - chosen[-1].stamp >= APART:
            chosen.append(view)
    return chosen


def compared(
    odometry: Sequence[Odometry], every: Pairs, mount_known: bool, scans: Sequence[LaserScan] = ()
) -> Comparison:
    """Compare odometry with pairs. scans: those of the pairs, one more; without them no contradictions are found."""
    nothing = Comparison(mount_known, float(every.begin[0]) if len(every.begin) else 0.0)
    matched = every.covariance[:, 2, 2] < MOST_DEVIATION**2
    if len(odometry) < 2 or matched.sum() < PAIRS:
        return nothing
    way = _Way(odometry)
    used = np.flatnonzero(matched & way.tells(every.begin - MOST_LAG, every.end + MOST_LAG))
    if len(used) < PAIRS:
        return nothing
    lag, of_lag = every.of(used[:: math.ceil(len(used) / MOST_PAIRS)]).lag(way)
    told = np.flatnonzero(matched & way.tells(every.begin - lag, every.end - lag))
    pairs = every.of(told)
    of_turn, of_way, predicted = pairs.fits(way, lag)
    scatter = _scatter(of_turn, of_way)
    a, b = of_way.x[:2]
    travel = max(math.hypot(a, b), 1e-6)
    radial = np.array([[a, b], [-b, a]]) / travel
    of_travel, of_yaw = np.sqrt(np.diagonal(radial @ np.linalg.inv(of_way.information)[:2, :2] @ radial.T))
    of_scale = float(of_turn.information[0, 0]) ** -0.5
    wrong = [
        k
        for k, predict in zip(told.tolist(), predicted, strict=True)
        if scans and _contradicted(scans[k], scans[k + 1], every.X[k], every.covariance[k], predict)
    ]
    chord, turned = way.moved(pairs.begin - lag, pairs.end - lag)
    sigma = np.sqrt(np.diagonal(pairs.covariance, axis1=1, axis2=2)).reshape(-1, 3)
    lengths, turns = np.hypot(pairs.X[:, 0], pairs.X[:, 1]), np.abs(pairs.X[:, 2])
    travels = (np.maximum(lengths, np.abs(chord)) > MOVES[0]) & (np.maximum(sigma[:, 0], sigma[:, 1]) < 0.2 * MOVES[0])
    turning = (np.maximum(turns, np.abs(turned)) > MOVES[1]) & (sigma[:, 2] < 0.2 * MOVES[1])
    return replace(
        nothing,
        turn=float(of_turn.x[0]),
        travel=travel,
        lag=lag,
        yaw=-math.atan2(b, a),
        deviations=scatter * np.array([of_scale, of_travel, of_lag, of_yaw / travel]),
        contradicts=_stretches(every.begin[wrong], every.end[wrong]),
        turning=np.array([turning.sum(), (turning & (of_turn.off < SURELY)).sum()], dtype=float),
        travelling=np.array([travels.sum(), (travels & (of_way.off < SURELY)).sum()], dtype=float),
        stands=bool(np.abs(chord).sum() < 0.1 * lengths.sum() and np.abs(turned).sum() < 0.1 * turns.sum()),
    )


def _scatter(of_turn: _Robust, of_way: _Robust) -> float:
    """Return the ratio of actual to assumed errors, from the medians of one and of two normal numbers."""
    return max(1.0, float(np.median(of_turn.off)) / 0.6745, float(np.median(of_way.off)) / 1.177)


def _contradicted(
    before: LaserScan, after: LaserScan, X: FloatArray, covariance: FloatArray, predicted: FloatArray
) -> bool:
    """Return whether the scans, which match at X (3,), contradict the predicted motion (3,)."""
    off = X - predicted
    off[2] = se2.wrap_angle(off[2])
    way, turn = math.hypot(off[0], off[1]), abs(off[2])
    if way < CONTRADICTS[0] and turn < CONTRADICTS[1]:
        return False
    errors = np.array([WAY_ERROR, WAY_ERROR, TURN_ERROR]) ** 2 + (SHARE_ERROR * X) ** 2
    if off @ np.linalg.solve(covariance + np.diag(errors), off) < SURELY**2:
        return False
    # The predicted motion may fit the scans as well.
    seen = surface(before), surface(after)
    return bool(fitting(*seen, predicted.copy()) < RIVAL * fitting(*seen, X.copy()))


def _ways(scans: Sequence[LaserScan]) -> Pairs:
    """Match each scan with the next, without odometry; nan if they do not match."""
    n = max(len(scans) - 1, 0)
    stamps = np.array([one.stamp for one in scans])
    X, covariance, speed = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan), np.zeros(3)
    seen = surface(scans[0]) if n else np.zeros((0, 6))
    for k, scan in enumerate(scans[1:]):
        was, seen, duration = seen, surface(scan), stamps[k + 1] - stamps[k]
        # Half of the previous turn rate, as the robot may have begun or ceased to turn.
        one = _matched(was, seen, speed * duration * [1.0, 1.0, 0.5]) if duration < TOO_FAR else None
        speed = np.zeros(3) if one is None else one.X / duration
        if one is not None:
            X[k], covariance[k] = one.X, one.covariance
    return Pairs(stamps[:-1], stamps[1:], X, covariance)


def judged(found: Comparison, least_lag: float = LEAST_LAG) -> Verdict:
    """Judge which corrections are significant and too large to be learnt with the map; a lag, from least_lag, s, on."""
    turn, travel, lag, yaw = found.turn, found.travel, found.lag, found.yaw
    refusal = _refusal(found)
    if refusal:
        return Verdict(refusal=refusal, against=refusal.startswith(AGAINST))
    turns, travels = found.turning[1] >= TELL, found.travelling[1] >= TELL
    sure = SURELY * found.deviations
    verdict, told = Verdict(), {}
    if turns and abs(turn - 1.0) > max(LEAST_SCALE, sure[0]):
        verdict = replace(verdict, turn=turn)
        told["turn_scale"] = (
            f"scans turn {turn:.3g} times as far as the odometry: see its gyro, or its wheels' distance"
        )
    if travels and abs(travel - 1.0) > max(LEAST_SCALE, sure[1]):
        verdict = replace(verdict, travel=travel)
        told["travel_scale"] = f"scans travel {travel:.3g} times as far as the odometry: see its wheels' radius"
    if (turns or travels) and abs(lag) > max(least_lag, sure[2]):
        verdict = replace(verdict, lag=lag)
        way = "ahead of" if lag > 0.0 else "behind"
        told["lag"] = f"the scans' clock is {abs(lag):.2f} s {way} the odometry's: see how both are stamped"
    if travels and abs(yaw) > max(LEAST_YAW, sure[3]):
        verdict = replace(verdict, yaw=yaw)
        degrees = math.degrees(yaw)
        told["mount_yaw"] = f"the scanner looks {degrees:.1f} degrees farther to the left than was said"
    return replace(verdict, notes=tuple(Note(kind, found.begun, text) for kind, text in told.items()))


def _refusal(found: Comparison) -> str:
    """Return the reason why odometry and scans are unusable together, "" if they are usable."""
    (turning, turns), (travelling, travels) = found.turning, found.travelling
    sure = SURELY * found.deviations
    if max(turning, travelling) >= PAIRS and found.stands:
        return "the odometry stands while the scans move: it tells nothing of the way; record odometry that moves"
    if turning >= TELL and turns >= EXPLAINED * turning:
        if found.turn + sure[0] < -0.1:
            return (
                f"{AGAINST} ({found.turn:.2f} times as far): if the scanner is mounted upside down or mirrored, "
                "--set hardware.scanner.flip=true; if the odometry's yaw falls in left turns, mend that: flip would "
                "mirror the map"
            )
        if abs(found.turn) + sure[0] < 0.15:
            return (
                "the scans do not turn while the odometry does: see whether the scanner is frozen, or the wheels slip"
            )
        if found.turn - sure[0] > MOST_SCALE:
            return f"scans turn {found.turn:.2g} times as far as the odometry: see its unit, rad"
    if travelling >= TELL and travels >= EXPLAINED * travelling:
        if found.travel + sure[1] < 0.15:
            return f"scans travel {found.travel:.2g} times as far as the odometry: see its unit, m; or its wheels slip"
        if found.travel - sure[1] > MOST_SCALE:
            return f"scans travel {found.travel:.2g} times as far as the odometry: see its unit, m"
        if found.mount_known and abs(found.yaw) - sure[3] > 2.5:
            return (
                "scans travel backwards where the odometry travels ahead: the scanner looks back, or the wheels are "
                "mirrored; --set hardware.scanner.yaw=3.1416 if it is the scanner"
            )
    for name, moves, explained in (("turns", turning, turns), ("moves", travelling, travels)):
        if moves >= PAIRS and explained < EXPLAINED * moves:
            return (
                f"scans and odometry contradict each other: by any scale, clock and mount {explained:.0f} of "
                f"{moves:.0f} {name} agree; see whether both are of one drive"
            )
    return ""


def corrected(
    odometry: Sequence[Odometry], scans: Sequence[LaserScan], verdict: Verdict
) -> tuple[tuple[Odometry, ...], tuple[LaserScan, ...]]:
    """Return odometry and scans with a verdict's corrections; the same objects if there are none."""
    odometry, scans = tuple(odometry), tuple(scans)
    if (verdict.turn, verdict.travel) != (1.0, 1.0) and odometry:
        X = np.array([one.X_OB for one in odometry])
        heading = np.unwrap(X[:, 2])
        steps = np.diff(X[:, 0] + 1j * X[:, 1]) * np.exp(-0.5j * (heading[1:] + heading[:-1]))
        heading = heading[0] + verdict.turn * (heading - heading[0])
        p = np.cumsum(verdict.travel * steps * np.exp(0.5j * (heading[1:] + heading[:-1])))
        X[1:, 0], X[1:, 1], X[:, 2] = X[0, 0] + p.real, X[0, 1] + p.imag, se2.wrap_angle(heading)
        speeds = np.array([verdict.travel, verdict.turn])
        odometry = tuple(replace(one, X_OB=x, V_B=speeds * one.V_B) for one, x in zip(odometry, X, strict=True))
    if verdict.yaw or verdict.lag:
        scans = tuple(_turned(replace(one, stamp=one.stamp - verdict.lag), verdict.yaw) for one in scans)
    return odometry, scans


def _turned(scan: LaserScan, yaw: float) -> LaserScan:
    if not yaw:
        return scan
    angles = se2.wrap_angle(scan.angles + yaw)
    order = np.argsort(angles, kind="stable")
    return replace(scan, angles=angles[order], ranges=scan.ranges[order])


def _stretches(begin: FloatArray, end: FloatArray) -> FloatArray:
    """Return intervals (n,), s, as stretches (k, 2) of time; those that follow each other closely are joined."""
    if not len(begin):
        return np.zeros((0, 2))
    apart = begin[1:] > end[:-1] + ONE_STRETCH
    return np.column_stack([begin[np.append(True, apart)], end[np.append(apart, True)]])


def bridged(
    scans: Sequence[LaserScan], begin: float, end: float, X_guess: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return the motion from begin to end, s, by consecutive scans: stamps (k,) from begin to end, poses (k, 3) in that
    at begin, and the covariance (3, 3) of the last. X_guess: (3,) guess of the whole motion. None if the scans do not
    determine it."""
    stamps = [one.stamp for one in scans]
    first, last = bisect.bisect_right(stamps, begin) - 1, bisect.bisect_left(stamps, end)
    if first < 0 or last >= len(scans) or end <= begin:
        return None
    near = scans[first : last + 1]
    X, covariance, poses = np.zeros(3), np.zeros((3, 3)), [np.zeros(3)]
    velocity, matched = X_guess / (end - begin), [near[0]]
    for after in near[1:]:
        before = matched[-1]
        duration = after.stamp - before.stamp
        if duration >= TOO_FAR:
            return None
        one = match(before, after, velocity * duration)
        if one is None:  # The next scan may match this one.
            continue
        matched.append(after)
        velocity = one.X / duration
        covariance = _composed(X, covariance, one)
        X = se2.compose(X, one.X)
        poses.append(X)
    if matched[-1] is not near[-1] or np.sqrt(np.diagonal(covariance)).max() > 0.15:
        return None
    known = np.array([one.stamp for one in matched])
    at = np.concatenate([[begin], known[(known > begin) & (known < end)], [end]])
    x, y, heading = np.array(poses).T
    way = np.column_stack([np.interp(at, known, value) for value in (x, y, np.unwrap(heading))])
    return at, se2.between(way[0], way), covariance


def _composed(X: FloatArray, covariance: FloatArray, step: Matched) -> FloatArray:
    """Return the covariance (3, 3) of X composed with a step."""
    c, s = math.cos(X[2]), math.sin(X[2])
    on_X = np.eye(3)
    on_X[:2, 2] = -s * step.X[0] - c * step.X[1], c * step.X[0] - s * step.X[1]
    on_step = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(on_X @ covariance @ on_X.T + on_step @ step.covariance @ on_step.T)


@message
class Watch:
    """Compares scans of a driving robot with its odometry from time to time. way: the newest odometry. before: the
    first scan of the next match, done: whether that was made. doubts: number of consecutive contradictions."""

    way: tuple[Odometry, ...] = ()
    before: LaserScan | None = None
    done: bool = False
    doubts: int = 0


def watched(watch: Watch, odometry: Odometry, scan: LaserScan) -> tuple[Watch, bool]:
    """Return the watch after the newest messages, and whether scans and odometry have contradicted each other for long:
    True once, and again only after they have agreed."""
    way, before, doubts = watch.way, watch.before, watch.doubts
    if not way or odometry.stamp > way[-1].stamp:
        way = (*way, odometry)[-KEPT:]
    after = 0.0 if before is None else scan.stamp - before.stamp
    if before is None or after > (EVERY if watch.done else TOO_FAR):
        return replace(watch, way=way, before=scan, done=False), False
    if watch.done or after < APART or len(way) < 2 or way[-1].stamp < scan.stamp or way[0].stamp > before.stamp:
        return replace(watch, way=way), False
    one = match(before, scan)
    if one is not None and one.covariance[2, 2] < MOST_DEVIATION**2:
        chord, turned = (value[0] for value in _Way(way).moved(np.array([before.stamp]), np.array([scan.stamp])))
        chord *= np.exp(0.5j * turned)
        predicted = np.array([chord.real, chord.imag, turned])
        doubts = doubts + 1 if _contradicted(before, scan, one.X, one.covariance, predicted) else 0
    return replace(watch, way=way, done=True, doubts=doubts), doubts == LONG and doubts > watch.doubts
