"""Plain-Python twins of the filters of face normals, written from the papers' formulas."""

from __future__ import annotations

import numpy as np

from tests.kernels.plain_faces import neighbours, normals_and_areas, rim, unit, updated


def threshold_normals(n: np.ndarray, rows: list[list[int]], T: float, passes: int) -> np.ndarray:
    """Sun et al.: weights max(0, n_i . n_j - T)^2, the face itself among its neighbours."""
    for _ in range(passes):
        new = np.empty_like(n)
        for i, row in enumerate(rows):
            new[i] = sum(max(0.0, n[i] @ n[j] - T) ** 2 * n[j] for j in [*row, i])
        n = unit(new)
    return n


def mean_distance(c: np.ndarray, faces: np.ndarray) -> float:
    """Mean distance between the centroids of faces that share an edge."""
    rows = neighbours(faces, "edge")
    return float(np.mean([np.linalg.norm(c[i] - c[j]) for i, row in enumerate(rows) for j in row]))


def bilateral_weights(
    n: np.ndarray, areas: np.ndarray, c: np.ndarray, rows: list[list[int]], widths
) -> np.ndarray:
    """Zheng et al.: the matrix w_ij for widths sigma_c and sigma_s, zero but for neighbours."""
    sigma_c, sigma_s = widths
    w = np.zeros((len(rows), len(rows)))
    for i, row in enumerate(rows):
        for j in row:
            apart = np.linalg.norm(c[i] - c[j])
            unlike = np.linalg.norm(n[i] - n[j])
            w[i, j] = areas[j] * np.exp(-(apart**2) / (2 * sigma_c**2))
            w[i, j] *= np.exp(-(unlike**2) / (2 * sigma_s**2))
    return w


def local_normals(n, areas, c, rows, widths, passes: int) -> np.ndarray:
    """Normalised sums of w_ij n_j, with n of the pass before; kept where there are none."""
    for _ in range(passes):
        sums = bilateral_weights(n, areas, c, rows, widths) @ n
        n = np.array(
            [unit(s) if len(row) else own for s, row, own in zip(sums, rows, n, strict=True)]
        )
    return n


def global_matrix(n, areas, c, rows, widths, fidelity: float) -> np.ndarray:
    """(1 - lambda) (I - W)^T (I - W) + lambda I; no difference for a face without neighbours."""
    w = bilateral_weights(n, areas, c, rows, widths)
    total = w.sum(axis=1, keepdims=True)
    linked = total > 0
    m = np.diag(linked[:, 0].astype(float)) - np.where(linked, w / np.where(linked, total, 1), 0)
    return (1 - fidelity) * m.T @ m + fidelity * np.eye(len(n))


def threshold_filter(v, faces, T=0.5, passes=20, vertex_passes=50, sharing="vertex", fixed=True):
    """Both stages after Sun et al."""
    n, _ = normals_and_areas(v, faces)
    n = threshold_normals(n, neighbours(faces, sharing), T, passes)
    return updated(v, n, faces, vertex_passes, rim(faces) if fixed else frozenset())


def local_filter(
    v, faces, widths=(1.0, 0.35), passes=20, vertex_passes=10, sharing="vertex", fixed=True
):
    """Both stages after Zheng et al.; sigma_c in mean distances, and sigma_s."""
    n, areas = normals_and_areas(v, faces)
    c = v[faces].mean(axis=1)
    absolute = widths[0] * mean_distance(c, faces), widths[1]
    n = local_normals(n, areas, c, neighbours(faces, sharing), absolute, passes)
    return updated(v, n, faces, vertex_passes, rim(faces) if fixed else frozenset())


def global_filter(
    v, faces, widths=(1.0, 0.35), fidelity=0.01, vertex_passes=10, sharing="vertex", fixed=True
):
    """The same by one solve; also the least length of a solution before it is normalised."""
    n, areas = normals_and_areas(v, faces)
    c = v[faces].mean(axis=1)
    absolute = widths[0] * mean_distance(c, faces), widths[1]
    matrix = global_matrix(n, areas, c, neighbours(faces, sharing), absolute, fidelity)
    solution = np.linalg.solve(matrix, fidelity * n)
    passed = updated(v, unit(solution), faces, vertex_passes, rim(faces) if fixed else frozenset())
    return passed, np.linalg.norm(solution, axis=1).min()
