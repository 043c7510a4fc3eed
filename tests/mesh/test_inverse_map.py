import numpy as np

from softcal_jax.mesh._location import nearest_on_face, nearest_on_triangles


def test_nearest_point_of_a_triangle_meets_every_part_of_it():
    """Against a fine sampling, for points over the inside, each edge and corner."""
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(3, 3))
    n = 200
    grid = [(i, j, n - i - j) for i in range(n + 1) for j in range(n + 1 - i)]
    samples = np.array(grid) / n @ corners
    spacing = max(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)) / n
    parts = set()
    for point in rng.normal(scale=3.0, size=(80, 3)):
        b = nearest_on_triangles(corners[None], point)[0]
        np.testing.assert_allclose(b.sum(), 1.0, rtol=1e-12)
        assert b.min() >= 0
        parts.add(tuple(b > 0))
        gap = np.linalg.norm(b @ corners - point)
        sampled = np.linalg.norm(samples - point, axis=1).min()
        assert gap <= sampled + 1e-12
        assert sampled <= np.hypot(gap, spacing) + spacing
        # A flat face with mid nodes is the same face.
        mids = (corners + np.roll(corners, -1, axis=0)) / 2.0
        curved = nearest_on_face(np.vstack([corners, mids]), point)
        np.testing.assert_allclose(curved, b, rtol=0, atol=1e-7)
    assert len(parts) == 7
