"""Where square tags of known size are, from the image of their corners: lens models undone, pose by least squares."""

from __future__ import annotations

import contextlib

import numpy as np

from tfg_drake.messages import FloatArray

# Newton and Gauss-Newton steps: each converges to rounding in fewer.
STEPS = 12
# No lens sees a corner farther out on the plane z = 1 (89.4 degrees).
WIDEST = 100.0


def undistort(pixels: FloatArray, intrinsics: FloatArray, model: str, coefficients: FloatArray) -> FloatArray:
    """Points (..., 2) on the plane z = 1 of the camera whose images are pixels (..., 2).

    intrinsics: fx, fy, cx, cy, px. model: "equidistant" (four coefficients; Kannala and Brandt 2006) or "radtan" (k1,
    k2, p1, p2; Brown 1971). Raises ValueError for another model.
    """
    distorted = (pixels - intrinsics[2:]) / intrinsics[:2]
    if model == "equidistant":
        radius = np.linalg.norm(distorted, axis=-1, keepdims=True)
        theta = radius.copy()
        k = coefficients
        for _ in range(STEPS):
            t2 = theta**2
            value = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
            slope = 1.0 + t2 * (3.0 * k[0] + t2 * (5.0 * k[1] + t2 * (7.0 * k[2] + t2 * 9.0 * k[3])))
            theta = theta - (value - radius) / slope
        scale = np.divide(np.tan(theta), radius, out=np.ones_like(radius), where=radius > 1e-12)
        return np.asarray(distorted * scale)
    if model == "radtan":
        k1, k2, p1, p2 = coefficients
        point = distorted.copy()
        for _ in range(4 * STEPS):  # a fixed point, not Newton
            x, y = point[..., 0], point[..., 1]
            r2 = x**2 + y**2
            tangential = np.stack(
                [2.0 * p1 * x * y + p2 * (r2 + 2.0 * x**2), p1 * (r2 + 2.0 * y**2) + 2.0 * p2 * x * y], axis=-1
            )
            point = (distorted - tangential) / (1.0 + k1 * r2 + k2 * r2**2)[..., None]
        return np.asarray(point)
    raise ValueError(f"unknown lens model {model!r}")


def square_centers(corners: FloatArray, sizes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The centres p_CT (n, 3) of square tags in the camera's frame C and their covariance (n, 3, 3) for unit noise.

    corners: (n, 4, 2) on the plane z = 1, in order round the tag, either way. sizes: (n,) side, m. The covariance is
    that of independent errors of the corners with standard deviation 1 on that plane. A homography gives the first
    pose (Zhang 2000), Gauss-Newton on the corners the rest. Rows are nan where the corners are no square's, or not
    within WIDEST: infinite ones would hang the singular value decomposition.
    """
    centers, covariance = np.full((len(corners), 3), np.nan), np.full((len(corners), 3, 3), np.nan)
    rows = np.flatnonzero((np.abs(corners) <= WIDEST).all(axis=(1, 2)) & (sizes > 0.0) & (sizes < np.inf))
    try:
        centers[rows], covariance[rows] = _solved(corners[rows], sizes[rows])
    except np.linalg.LinAlgError:
        for row in rows[:, None]:
            with contextlib.suppress(np.linalg.LinAlgError):
                centers[row], covariance[row] = _solved(corners[row], sizes[row])
    return centers, covariance


def _solved(corners: FloatArray, sizes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The centres and covariances of corners that are finite; raises LinAlgError where one of them is no square's."""
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    points = sizes[:, None, None] * np.column_stack([square, np.zeros(4)])
    R, t = _from_homography(corners, points)
    normal = np.tile(np.eye(6), (len(corners), 1, 1))
    for _ in range(STEPS):
        rotated = np.einsum("nij,nkj->nki", R, points)
        p = rotated + t[:, None]
        inverse_z = 1.0 / p[..., 2]
        residual = p[..., :2] * inverse_z[..., None] - corners
        on_p = np.zeros((*p.shape[:2], 2, 3))
        on_p[..., 0, 0] = on_p[..., 1, 1] = inverse_z
        on_p[..., :, 2] = -p[..., :2] * (inverse_z**2)[..., None]
        jacobian = np.concatenate([-on_p @ _cross(rotated), on_p], axis=-1).reshape(len(p), 8, 6)
        normal = np.swapaxes(jacobian, 1, 2) @ jacobian
        step = -np.linalg.solve(normal, np.swapaxes(jacobian, 1, 2) @ residual.reshape(-1, 8, 1))[..., 0]
        R = _exp(step[:, :3]) @ R
        t = t + step[:, 3:]
    return t, np.asarray(np.linalg.inv(normal)[:, 3:, 3:])


def _from_homography(corners: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    n = len(corners)
    A = np.zeros((n, 8, 9))
    X = np.concatenate([points[..., :2], np.ones((n, 4, 1))], axis=-1)
    A[:, 0::2, 0:3], A[:, 1::2, 3:6] = X, X
    A[:, 0::2, 6:9], A[:, 1::2, 6:9] = -corners[..., :1] * X, -corners[..., 1:] * X
    H = np.linalg.svd(A)[2][:, -1].reshape(n, 3, 3)
    scale = 0.5 * (np.linalg.norm(H[:, :, 0], axis=1) + np.linalg.norm(H[:, :, 1], axis=1))
    with np.errstate(all="ignore"):
        H = H / (np.sign(H[:, 2, 2]) * scale)[:, None, None]  # in front of the camera
    if not (np.abs(H) < 1e100).all():
        raise np.linalg.LinAlgError("corners on a line")
    U, _, Vt = np.linalg.svd(np.stack([H[:, :, 0], H[:, :, 1], np.cross(H[:, :, 0], H[:, :, 1])], axis=2))
    U[..., 2] *= np.linalg.det(U @ Vt)[:, None]
    return np.asarray(U @ Vt), np.asarray(H[:, :, 2])


def _cross(v: FloatArray) -> FloatArray:
    """(..., 3, 3) matrices of the cross product with v (..., 3)."""
    zero = np.zeros(v.shape[:-1])
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    return np.stack([np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], axis=-2)


def _exp(v: FloatArray) -> FloatArray:
    """Rotation matrices (n, 3, 3) of rotation vectors (n, 3), by Rodrigues."""
    angle = np.linalg.norm(v, axis=1)[:, None, None]
    K = _cross(v)
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * K + 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * K @ K)
