"""How fast a swing goes round and comes to rest: decay and angular frequency by variable projection."""

from __future__ import annotations

import numpy as np

LEAST_EXPLAINED = 0.5  # of the variance; a fit that explains less says nothing
ANGLES = 0.25  # turns over the window between two angular frequencies that are tried
FASTEST = 0.25  # turns from frame to frame: a swing is seen four times or more
DECAYS = (0.0, 1.0, 4.0, 16.0)  # over the window, that are tried


def poles(time: np.ndarray, q: np.ndarray) -> np.ndarray:
    """−δ + iω [1/s] (B,) of the swings c + exp(−δt) (a cos ωt + b sin ωt) that fit q (B, K) at time (K,) s best; NaN
    where q is not a number or does not change, or where less than half of its variance is explained.
    """
    out = np.full(len(q), complex(np.nan, np.nan))
    whole = np.flatnonzero(np.isfinite(q).all(axis=1))
    centred = q[whole] - q[whole].mean(axis=1, keepdims=True)
    size = np.sqrt((centred**2).mean(axis=1))
    moves = size > 1e-9  # m; below, it is rounding
    whole, centred = whole[moves], centred[moves] / size[moves][:, None]
    if not len(whole):
        return out
    length, step = time[-1], float(np.median(np.diff(time)))
    unit = time / length
    fastest = 2 * np.pi * FASTEST * length / step
    starts = tried(unit, centred, fastest)
    for b, values, start in zip(whole, centred, starts, strict=True):
        delta, omega, explained = refined(unit, values, start, fastest)
        if explained >= LEAST_EXPLAINED:
            out[b] = complex(-delta, omega) / length
    return out


def tried(unit: np.ndarray, q: np.ndarray, fastest: float) -> np.ndarray:
    """The decay and the angular frequency (B, 2), over the window, of the grid that explain most of q (B, K), which has
    no mean, at unit (K,), 0 to 1.
    """
    omega = np.arange(np.pi, max(fastest, np.pi) + 1e-9, 2 * np.pi * ANGLES)
    best, out = np.full(len(q), -np.inf), np.zeros((len(q), 2))
    for delta in DECAYS:
        for some in np.array_split(omega, -(-len(omega) * len(unit) // 2**20)):  # a few megabytes at a time
            wave = np.exp((-delta + 1j * some[:, None]) * unit)
            wave -= wave.mean(axis=1, keepdims=True)
            cos, sin = wave.real, wave.imag
            c, s = cos @ q.T, sin @ q.T
            cc, ss, cs = ((x * y).sum(axis=1)[:, None] for x, y in ((cos, cos), (sin, sin), (cos, sin)))
            explained = (ss * c**2 - 2 * cs * c * s + cc * s**2) / (cc * ss - cs**2)
            k = explained.argmax(axis=0)
            most = explained[k, np.arange(len(q))]
            out[most > best] = np.stack([np.full(len(q), delta), some[k]], axis=1)[most > best]
            best = np.maximum(best, most)
    return out


def refined(unit: np.ndarray, q: np.ndarray, start: np.ndarray, fastest: float) -> tuple[float, float, float]:
    """Decay and angular frequency over the window by least squares from `start`, and the share of the variance of
    q (K,), 1 in all, that they explain.
    """
    from scipy.optimize import least_squares

    def basis(x: np.ndarray) -> np.ndarray:
        fade = np.exp(-x[0] * unit)
        return np.stack([np.ones(len(unit)), fade * np.cos(x[1] * unit), fade * np.sin(x[1] * unit)], axis=1)

    def fitted(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Basis (K, 3), its amounts (3,), and what they leave (K,)."""
        columns = basis(x)
        amount = np.linalg.lstsq(columns, q, rcond=None)[0]
        return columns, amount, columns @ amount - q

    def jacobian(x: np.ndarray) -> np.ndarray:
        """Of what is left, with the amounts held, outside of what these could take up (Kaufman's, (K, 2))."""
        columns, (_, a, b), _ = fitted(x)
        slope = np.stack([-unit * (columns[:, 1:] @ [a, b]), unit * (columns[:, 1:] @ [b, -a])], axis=1)
        own, _ = np.linalg.qr(columns)
        return slope - own @ (own.T @ slope)

    low, high = np.array([-5.0, np.pi / 2]), np.array([max(fastest, 32.0), max(fastest, np.pi) + np.pi])
    x = least_squares(lambda x: fitted(x)[2], np.clip(start, low, high), jacobian, (low, high), xtol=1e-12).x
    for _ in range(3):  # the cost is flat where these end; its last digits would hang on the order of the nodes
        x = np.clip(x - np.linalg.lstsq(jacobian(x), fitted(x)[2], rcond=None)[0], low, high)
    return float(x[0]), float(x[1]), 1 - float(np.mean(fitted(x)[2] ** 2))
