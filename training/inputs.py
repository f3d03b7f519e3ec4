"""The inputs of the network of ``learned``, written down to learn from.

To predict normals they are made a block of faces at a time, and are not kept: the kernel here is
compiled by numba when it is first used.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kernel_build.numba_kernels import to_dispatcher
from msal_cli.kernels.lanes import LANES
from msal_cli.kernels.library import compiled
from msal_cli.kernels.normal_descriptors import NUMBERS, S1, lay_inputs, memory_for_inputs
from msal_cli.kernels.normal_regression import GLOBALS, STATISTICS, Descriptors
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.vectors import ZERO

Singles = NDArray[np.float32]


def collect_inputs(descriptors: Descriptors) -> tuple[Singles, Singles]:
    """What the network sees of each face, and the candidates (m, k, 3) for its normal.

    The inputs are the candidates along axes of the face, NUMBERS, STATISTICS and GLOBALS.
    """
    m, k = len(descriptors.sources[1]), descriptors.n_vectors
    own = np.empty((m, 3 * k + NUMBERS + STATISTICS), dtype=np.float32)
    vectors = np.empty((m, 3 * k), dtype=np.float32)
    of = *descriptors.sources, descriptors.is_later
    over_ranges(to_dispatcher(_collect), m, *of, own, vectors)
    shared = np.broadcast_to(descriptors.globals, (m, GLOBALS))
    return np.concatenate([own, shared], axis=1), vectors.reshape(m, k, 3)


@compiled
def _collect(
    start,
    stop,
    points,
    units,
    unit,
    near_start,
    near,
    known,
    records,
    statistics,
    others,
    is_later,
    inputs,
    vectors,
):
    """The inputs (m, n_in) and the vectors (m, 3 k) of all faces, for training."""
    of = points, units, unit, near_start, near, known, records, statistics, others
    memory = memory_for_inputs(start, stop, near_start)
    n_in, n_vectors = np.uint64(inputs.shape[1]), np.uint64(vectors.shape[1])
    of_vectors = np.empty(np.int64(S1 * n_vectors), dtype=np.float32)
    x = np.empty(np.int64(S1 * n_in), dtype=np.float32)
    last = np.uint64(stop)
    for first in range(np.uint64(start), last, LANES):
        lay_inputs(first, last, ZERO, of, is_later, memory, of_vectors, x)
        for lane in range(min(LANES, last - first)):
            for k in range(n_in):
                inputs[first + lane, k] = x[k * S1 + lane]
            for k in range(n_vectors):
                vectors[first + lane, k] = of_vectors[k * S1 + lane]
