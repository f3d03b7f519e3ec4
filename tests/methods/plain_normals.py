"""Plain twins of the filters of face normals, face by face, from the papers' formulas."""

import itertools

import numpy as np


def unit(vectors: np.ndarray) -> np.ndarray:
    """Each row (k, 3) divided by its length."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def normals_and_areas(x: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals and areas; zero normals where the area is zero."""
    a, b, c = (x[faces[:, corner]] for corner in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    return cross / np.where(length > 0, length, 1)[:, None], length / 2


def sharing(faces: np.ndarray, corners: int) -> list[set[int]]:
    """For each face the others with which it shares at least so many corners."""
    sets = [set(face) for face in faces.tolist()]
    return [
        {g for g, other in enumerate(sets) if g != f and len(own & other) >= corners}
        for f, own in enumerate(sets)
    ]


def neighbours(faces: np.ndarray, kind: str) -> list[list[int]]:
    """For each face those that share an edge, or a vertex, with it."""
    return [sorted(row) for row in sharing(faces, 2 if kind == "edge" else 1)]


def mean_distance(centroids: np.ndarray, across) -> float:
    """Mean distance of centroids over the pairs of faces."""
    pairs = [(f, g) for f, others in enumerate(across) for g in others if g > f]
    return float(np.mean([np.linalg.norm(centroids[f] - centroids[g]) for f, g in pairs]))


def flood(first: int, beside, points: np.ndarray, centre: np.ndarray, radius: float) -> set[int]:
    """What ``beside`` leads to from the first through points within the radius of a centre."""
    found, waiting = {first}, [first]
    while waiting:
        for k in set(beside[waiting.pop()]) - found:
            if np.linalg.norm(points[k] - centre) <= radius:
                found.add(k)
                waiting.append(k)
    return found


def near(centroids: np.ndarray, touching: list[set[int]], radius: float) -> list[set[int]]:
    """The faces within the radius that touch the face or others found before."""
    return [
        flood(f, touching, centroids, centre, radius) - {f} for f, centre in enumerate(centroids)
    ]


def guides(
    normals: np.ndarray, areas: np.ndarray, touching: list[set[int]], across: list[set[int]]
) -> np.ndarray:
    """Mean normals of the patches with the least scores."""
    has_normal = normals.any(axis=1)
    jump = np.linalg.norm(normals[:, None] - normals, axis=2) * np.outer(has_normal, has_normal)
    scores, means = [], []
    for f, others in enumerate(touching):
        patch = sorted(others | {f})
        jumps = [jump[a, b] for a in patch for b in across[a].intersection(patch) if a < b]
        widest = jump[np.ix_(patch, patch)].max()
        scores.append(widest * max(jumps) / (1e-9 + sum(jumps)))
        means.append(unit(sum(areas[a] * normals[a] for a in patch)))
    best = [min([f, *others], key=lambda g: scores[g]) for f, others in enumerate(touching)]
    return np.array([means[g] for g in best])


def joint(n, like, areas, c, rows, sigma_s: float, sigma_r: float) -> np.ndarray:
    """Normalised sums over each face and its row, by area, distance and likeness of guides."""
    result = np.empty_like(n)
    for i, row in enumerate(rows):
        j = [i, *row]
        far = ((c[j] - c[i]) ** 2).sum(axis=1) / (2 * sigma_s**2)
        unlike = ((like[j] - like[i]) ** 2).sum(axis=1) / (2 * sigma_r**2)
        result[i] = unit((areas[j] * np.exp(-far - unlike)) @ n[j])
    return result


def edge_faces(faces: np.ndarray) -> dict[tuple[int, int], list[int]]:
    """Every edge as (i, k) with i < k, and the numbers of its faces."""
    edges: dict[tuple[int, int], list[int]] = {}
    for f, face in enumerate(faces.tolist()):
        for edge in itertools.combinations(sorted(face), 2):
            edges.setdefault(edge, []).append(f)
    return edges


def inner(x: np.ndarray, faces: np.ndarray, fixed: bool = True) -> np.ndarray:
    """Which vertices are no ends of an edge that one face has; all unless ``fixed``."""
    free = np.ones(len(x), dtype=bool)
    if fixed:
        free[[i for edge, own in edge_faces(faces).items() if len(own) == 1 for i in edge]] = False
    return free


def moved(
    x: np.ndarray, normals: np.ndarray, faces: np.ndarray, free: np.ndarray, passes: int
) -> np.ndarray:
    """Vertices after so many moves towards the planes through the centroids of their faces."""
    for _ in range(passes):
        centroids = x[faces].mean(axis=1)
        new = x.copy()
        for i in np.flatnonzero(free):
            around = np.flatnonzero((faces == i).any(axis=1) & normals.any(axis=1))
            if len(around):
                heights = ((centroids[around] - x[i]) * normals[around]).sum(axis=1)
                new[i] = x[i] + (heights[:, None] * normals[around]).mean(axis=0)
        x = new
    return x


def bilateral_weights(n, areas, c, rows, widths) -> np.ndarray:
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


def global_matrix(n, areas, c, rows, widths, fidelity: float) -> np.ndarray:
    """(1 - lambda) (I - W)^T (I - W) + lambda I; no difference for a face without neighbours."""
    w = bilateral_weights(n, areas, c, rows, widths)
    total = w.sum(axis=1, keepdims=True)
    linked = total > 0
    m = np.diag(linked[:, 0].astype(float)) - np.where(linked, w / np.where(linked, total, 1), 0)
    return (1 - fidelity) * m.T @ m + fidelity * np.eye(len(n))


def threshold_filter(v, faces, T, passes, vertex_passes, kind, fixed):
    """Sun et al.: weights max(0, n_i . n_j - T)^2, the face itself among its neighbours."""
    n, _ = normals_and_areas(v, faces)
    rows = neighbours(faces, kind)
    for _ in range(passes):
        n = unit(
            np.array(
                [
                    sum(max(0.0, n[i] @ n[j] - T) ** 2 * n[j] for j in [*row, i])
                    for i, row in enumerate(rows)
                ]
            )
        )
    return moved(v, n, faces, inner(v, faces, fixed), vertex_passes)


def _prepare(v, faces, widths, kind):
    """Normals, areas, centroids, rows of neighbours, and widths of which sigma_c is absolute."""
    c = v[faces].mean(axis=1)
    absolute = widths[0] * mean_distance(c, sharing(faces, 2)), widths[1]
    return *normals_and_areas(v, faces), c, neighbours(faces, kind), absolute


def local_filter(v, faces, widths, passes, vertex_passes, kind, fixed):
    """Zheng et al.: normalised sums of w_ij n_j; sigma_c in mean distances, and sigma_s."""
    n, areas, c, rows, absolute = _prepare(v, faces, widths, kind)
    for _ in range(passes):
        sums = bilateral_weights(n, areas, c, rows, absolute) @ n
        n = np.array([unit(s) if row else own for s, row, own in zip(sums, rows, n, strict=True)])
    return moved(v, n, faces, inner(v, faces, fixed), vertex_passes)


def global_filter(v, faces, widths, fidelity, vertex_passes, kind, fixed):
    """The same by one solve; also the least length of a solution before it is normalised."""
    n, *prepared = _prepare(v, faces, widths, kind)
    solution = np.linalg.solve(global_matrix(n, *prepared, fidelity), fidelity * n)
    out = moved(v, unit(solution), faces, inner(v, faces, fixed), vertex_passes)
    return out, np.linalg.norm(solution, axis=1).min()
