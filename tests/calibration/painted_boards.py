"""Pictures of boards in front of cameras, painted exactly: every pixel's ray is cut with the board's plane."""

import cv2
import numpy as np

from hypose.calibration.boards import Board, opencv_charuco
from hypose.cameras.camera import Camera
from hypose.geometry import se3_inverse

TEXTURE_PX = 48  # per square


def texture(board: Board, grow: int = 0):
    """(h, w) uint8 with one square of white around the squares. grow: px by which white eats black (overexposure)."""
    nx, ny = board.columns + 1, board.rows + 1
    if board.kind == "charuco":
        nx, ny = board.columns, board.rows
        inner = opencv_charuco(board).generateImage((nx * TEXTURE_PX, ny * TEXTURE_PX))
    else:
        cells = (np.indices((ny, nx)).sum(0) % 2).astype(np.uint8) * 210 + 20
        inner = np.kron(cells, np.ones((TEXTURE_PX, TEXTURE_PX), np.uint8))
    sheet = np.pad(inner, TEXTURE_PX, constant_values=230)
    if grow:
        sheet = cv2.dilate(sheet, np.ones((2 * grow + 1, 2 * grow + 1), np.uint8))
    return 255 - sheet if board.inverted else sheet


def paint(board: Board, camera: Camera, world_from_board, rng=None, noise=2.0, blur=0.6, sheet=None, super_px=2):
    """(h, w, 3) BGR picture of the board on a grey ground; a pinhole camera."""
    sheet = texture(board) if sheet is None else sheet
    w, h = camera.size
    step = (np.arange(super_px) + 0.5) / super_px - 0.5
    x = (np.arange(w)[:, None] + step).ravel()
    y = (np.arange(h)[:, None] + step).ravel()
    pixels = np.stack(np.meshgrid(x, y), -1)
    assert not camera.distortion.any()  # inverting a lens for so many rays takes minutes
    rays = (np.concatenate([pixels, np.ones((*pixels.shape[:-1], 1))], -1)) @ np.linalg.inv(camera.K).T
    origin, rays = camera.position, rays @ camera.camera_from_world[:3, :3]
    board_from_world = se3_inverse(world_from_board)
    o = board_from_world[:3, :3] @ origin + board_from_world[:3, 3]
    d = rays @ board_from_world[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        s = -o[2] / d[..., 2]
    hit = o[:2] + s[..., None] * d[..., :2]
    # the board's first inner corner (chessboard), or its outer corner (ChArUco), one square of white before it
    first = 2 if board.kind == "chessboard" else 1
    uv = ((hit / board.square + first) * TEXTURE_PX - 0.5).astype(np.float32)
    seen = (s > 0) & (uv > 0).all(-1) & (uv[..., 0] < sheet.shape[1] - 1) & (uv[..., 1] < sheet.shape[0] - 1)
    values = cv2.remap(sheet, uv, None, cv2.INTER_LINEAR)
    ground = 105 + 25 * np.sin(pixels[..., 0] / 37) * np.sin(pixels[..., 1] / 29)
    image = np.where(seen, values, ground).reshape(h, super_px, w, super_px).mean((1, 3))
    if blur:
        image = cv2.GaussianBlur(image, (0, 0), blur)
    if rng is not None:
        image = image + rng.normal(0, noise, image.shape)
    gray = np.clip(image, 0, 255).round().astype(np.uint8)
    return np.repeat(gray[..., None], 3, 2)
