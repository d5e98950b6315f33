"""A motion at other times than those of its frames."""

import numpy as np


def at_other_times(time: np.ndarray, position: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Positions (T, N, 3) m at stamps (T,) s, at `wanted` (T, N) s → (T, N, 3) m: cubic Hermite between the frames with
    central differences for slopes; on as it went, evenly, before the first frame and after the last.
    """
    if len(time) < 2:
        return position
    beyond, wanted = wanted - np.clip(wanted, time[0], time[-1]), np.clip(wanted, time[0], time[-1])
    slope = np.gradient(position, time, axis=0, edge_order=2 if len(time) > 2 else 1)
    k = np.clip(np.searchsorted(time, wanted, side="right") - 1, 0, len(time) - 2)
    step = (time[k + 1] - time[k])[..., None]
    s = (wanted - time[k])[..., None] / step
    node = np.broadcast_to(np.arange(position.shape[1]), k.shape)
    a, b, da, db = position[k, node], position[k + 1, node], slope[k, node] * step, slope[k + 1, node] * step
    on = beyond[..., None] * np.where(beyond[..., None] < 0, slope[0], slope[-1])
    a, b = a + on, b + on  # the weights of both are 1 together
    return (2 * s**3 - 3 * s**2 + 1) * a + (s**3 - 2 * s**2 + s) * da + (3 * s**2 - 2 * s**3) * b + (s**3 - s**2) * db
