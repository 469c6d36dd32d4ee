import math

import numpy as np
import pytest
from PIL import Image

from tests.geometry.states import state_at
from up_samp.geometry import OccupancyGrid, load_map, write_map
from up_samp.model import ProblemError

KEYS = "resolution: 0.5\norigin: [1.0, 2.0, 0.0]\nnegate: 0\n"
THRESHOLDS = "occupied_thresh: 0.65\nfree_thresh: 0.196\n"


def write(folder, pixels, text=KEYS + THRESHOLDS, name="map.png", image=None):
    image = image or Image.fromarray(np.asarray(pixels, dtype=np.uint8))
    image.save(folder / name)
    path = folder / "map.yaml"
    path.write_text(f"image: {name}\n{text}")
    return path


def test_rows_run_upwards_and_classes_are_kept_apart(tmp_path):
    grid = load_map(write(tmp_path, [[0, 255, 128], [255, 255, 255]]))
    assert grid.occupied.tolist() == [[False] * 3, [True, False, False]]
    assert grid.unknown.tolist() == [[False] * 3, [False, False, True]]
    assert grid.blocked.sum() == 2
    assert state_at(grid, 1.1, 2.6) == "occupied"
    assert state_at(grid, 2.1, 2.6) == "unknown"
    assert state_at(grid, 1.1, 2.1) == "free"
    assert state_at(grid, 0.9, 2.1) == "outside"
    assert grid.size == (1.5, 1.0)


def test_negate_swaps_black_and_white(tmp_path):
    text = KEYS.replace("negate: 0", "negate: 1") + THRESHOLDS
    grid = load_map(write(tmp_path, [[0, 255]], text))
    assert grid.occupied.tolist() == [[False, True]]


def test_raw_mode_is_in_per_cent(tmp_path):
    grid = load_map(write(tmp_path, [[0, 100, 30, 255]], KEYS + THRESHOLDS + "mode: raw\n"))
    assert grid.occupied.tolist() == [[False, True, False, False]]
    assert grid.unknown.tolist() == [[False, False, True, True]]


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "LA", "P", "1", "L"])
def test_image_kinds(tmp_path, mode):
    image = Image.fromarray(np.array([[0, 255]], dtype=np.uint8)).convert(mode)
    grid = load_map(write(tmp_path, None, image=image))
    assert grid.occupied.tolist() == [[True, False]]
    assert not grid.unknown.any()


def test_transparent_is_unknown(tmp_path):
    pixels = np.array([[[0, 0, 0, 255], [255, 255, 255, 255], [255, 255, 255, 0]]], np.uint8)
    grid = load_map(write(tmp_path, None, image=Image.fromarray(pixels)))
    assert grid.occupied.tolist() == [[True, False, False]]
    assert grid.unknown.tolist() == [[False, False, True]]


def test_sixteen_bit_png(tmp_path):
    image = Image.fromarray(np.array([[0, 65535, 32768]], dtype=np.uint16))
    grid = load_map(write(tmp_path, None, image=image))
    assert grid.occupied.tolist() == [[True, False, False]]
    assert grid.unknown.tolist() == [[False, False, True]]


@pytest.mark.parametrize(
    "content", [b"P2\n# made by hand\n3 1\n255\n0 255 128\n", b"P5\n3 1\n255\n\x00\xff\x80"]
)
def test_pgm(tmp_path, content):
    (tmp_path / "map.pgm").write_bytes(content)
    (tmp_path / "map.yaml").write_text("image: map.pgm\n" + KEYS + THRESHOLDS)
    grid = load_map(tmp_path / "map.yaml")
    assert grid.occupied.tolist() == [[True, False, False]]
    assert grid.unknown.tolist() == [[False, False, True]]


def test_origin_with_yaw(tmp_path):
    text = KEYS.replace("0.0]", f"{math.pi / 2}]") + THRESHOLDS
    grid = load_map(write(tmp_path, [[255, 0]], text))
    # the map's x axis points along the world's y axis
    assert state_at(grid, 0.75, 2.25) == "free"
    assert state_at(grid, 0.75, 2.75) == "occupied"
    assert grid.point_of(0, 1) == pytest.approx((0.75, 2.75))
    two = KEYS.replace("[1.0, 2.0, 0.0]", "[1.0, 2.0]") + THRESHOLDS
    assert load_map(write(tmp_path, [[255, 0]], two)).origin == (1.0, 2.0, 0.0)


def test_write_and_read_again(tmp_path):
    rng = np.random.default_rng(1)
    occupied = rng.random((30, 40)) < 0.3
    unknown = ~occupied & (rng.random((30, 40)) < 0.1)
    path = write_map(tmp_path / "deep", "floor", occupied, 0.1, (1.5, -2.0, 0.25), unknown)
    grid = load_map(path)
    assert np.array_equal(grid.occupied, occupied)
    assert np.array_equal(grid.unknown, unknown)
    assert grid.resolution == 0.1
    assert grid.origin == (1.5, -2.0, 0.25)
    again = OccupancyGrid(occupied, 0.1, (1.5, -2.0, 0.25), unknown=unknown)
    assert again.digest == grid.digest
    assert OccupancyGrid(occupied, 0.1).digest != grid.digest


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("origin: [0, 0, 0]\n", "resolution"),
        ("resolution: 0\n", "resolution"),
        ("resolution: abc\n", "resolution"),
        (KEYS + "origins: [0, 0]\n", "origins"),
        (KEYS.replace("[1.0, 2.0, 0.0]", "[1.0]"), "origin"),
        (KEYS.replace("[1.0, 2.0, 0.0]", "[1.0, x, 0.0]"), "origin y"),
        (KEYS + "mode: odd\n", "mode"),
        (KEYS.replace("negate: 0", "negate: 3"), "negate"),
        (KEYS + "free_thresh: 0.9\n", "free_thresh"),
    ],
)
def test_bad_values_are_named(tmp_path, text, said):
    path = write(tmp_path, [[0, 255]], text)
    with pytest.raises(ProblemError, match=said) as error:
        load_map(path)
    assert str(path) in str(error.value)


def test_missing_and_broken_files(tmp_path):
    with pytest.raises(ProblemError, match="does not exist"):
        load_map(tmp_path / "none.yaml")
    path = tmp_path / "map.yaml"
    path.write_text("image: none.png\n" + KEYS)
    with pytest.raises(ProblemError, match=r"none\.png"):
        load_map(path)
    (tmp_path / "none.png").write_bytes(b"no image")
    with pytest.raises(ProblemError, match="cannot be read"):
        load_map(path)
    path.write_text("image: [unclosed\n")
    with pytest.raises(ProblemError, match="not readable YAML"):
        load_map(path)
    path.write_text("- a\n- b\n")
    with pytest.raises(ProblemError, match="must hold keys"):
        load_map(path)
    path.write_text(KEYS)
    with pytest.raises(ProblemError, match="image"):
        load_map(path)


def test_grids_check_themselves():
    with pytest.raises(ProblemError, match="two-dimensional"):
        OccupancyGrid(np.zeros(3, dtype=bool), 0.1)
    with pytest.raises(ProblemError, match="resolution"):
        OccupancyGrid(np.zeros((2, 2), dtype=bool), -1)
