"""Lines of sight of feature cells and boxes. Counterpart of `rays.rs` in the Rust crates.

Pixels: OpenCV, the top-left pixel's center is (0, 0). Directions are unit vectors; origins and
moments are in metres. Training cameras are pinholes; at inference Rust uses the true lens.
"""

import torch

BOX_RAY_GAIN = 10.0  # half extents are angles of a few degrees: brought to the order of 1


def cell_centers(level_shapes, strides, device=None) -> torch.Tensor:
    """Pixel (u, v) of every cell's center, all levels one after the other [N, 2].

    The cells of a level share the whole input evenly, whose size the finest level gives: 480 rows
    of pixels at stride 64 are 8 rows of cells, 60 px apart.
    """
    height, width = (cells * strides[0] for cells in level_shapes[0])
    centers = []
    for rows, columns in level_shapes:
        v, u = torch.meshgrid(
            torch.arange(rows, device=device), torch.arange(columns, device=device), indexing="ij"
        )
        cell = torch.tensor([width / columns, height / rows], device=device)
        centers.append((torch.stack([u, v], -1).reshape(-1, 2) + 0.5) * cell - 0.5)
    return torch.cat(centers)


def unproject(k: torch.Tensor, pixels: torch.Tensor) -> torch.Tensor:
    """Unit rays [..., n, 3] of `pixels` [..., n, 2] through pinholes `k` [..., 3, 3]."""
    focal, center = k[..., None, [0, 1], [0, 1]], k[..., None, :2, 2]
    xy = (pixels - center) / focal
    return torch.nn.functional.normalize(torch.cat([xy, torch.ones_like(xy[..., :1])], -1), dim=-1)


def encode(camera_rays, ref_from_cam, encoding: str) -> torch.Tensor:
    """Line-of-sight encoding of each cell in the reference camera's frame.

    camera_rays   [..., N, 3] unit, all zero where a cell has no ray
    ref_from_cam  [..., 4, 4] metres
    returns       [..., N, R]; zero where there is no ray

    Paper, section 6 (ablation of the encodings); the moment is d x o, as printed there.
    """
    has_ray = (camera_rays != 0).any(-1, keepdim=True)
    d = camera_rays @ ref_from_cam[..., :3, :3].transpose(-1, -2)
    o = ref_from_cam[..., None, :3, 3].expand_as(d)
    m = torch.linalg.cross(d, o)
    parts = {
        "direction": [d],
        "origin_direction": [o, d],
        "plucker": [d, m],
        "plucker_origin": [d, m, o],
    }[encoding]
    return torch.cat(parts, -1) * has_ray


def box_rays(k, boxes, ref_from_cam) -> torch.Tensor:
    """Lines of sight of boxes: origin, center ray and half extents, in the reference frame.

    k             [..., 3, 3]
    boxes         [..., Q, 4] x0, y0, x1, y1, px
    ref_from_cam  [..., 4, 4] metres
    returns       [..., Q, 12]: o, d_c, 10 e_x, 10 e_y with e_x = (ray(right) - ray(left)) / 2
    """
    x0, y0, x1, y1 = boxes.unbind(-1)
    xc, yc = (x0 + x1) / 2, (y0 + y1) / 2
    points = torch.stack(
        [torch.stack(p, -1) for p in ((xc, yc), (x0, yc), (x1, yc), (xc, y0), (xc, y1))], -2
    )  # [..., Q, 5, 2]
    q = points.shape[-3]
    d = unproject(k, points.flatten(-3, -2)) @ ref_from_cam[..., :3, :3].transpose(-1, -2)
    d = d.unflatten(-2, (q, 5))
    o = ref_from_cam[..., None, :3, 3].expand_as(d[..., 0, :])
    e_x, e_y = (d[..., 2, :] - d[..., 1, :]) / 2, (d[..., 4, :] - d[..., 3, :]) / 2
    return torch.cat([o, d[..., 0, :], BOX_RAY_GAIN * e_x, BOX_RAY_GAIN * e_y], -1)
