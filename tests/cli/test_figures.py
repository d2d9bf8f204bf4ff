"""--figures: which files there are, that they are what they claim, and the same every time."""

import json
import os
import struct
import xml.etree.ElementTree
import zlib

import pytest
from simulator import read_log, sim, summary

ENDINGS = ("pdf", "png", "svg")
SINGLES = ("", "_path", "_errors", "_velocities", "_clearance", "_mode")
SHORT = ("--set", "duration_s=8")


def figures(stem, singles=SINGLES):
    return {f"{stem}{single}.{ending}" for single in singles for ending in ENDINGS}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Figures of one run, in a folder that did not exist."""
    path = tmp_path_factory.mktemp("figures") / "made" / "for this"
    summary("run", "circle", "--strategy", "conservative", *SHORT, "--figures", path)
    return path


def test_a_run_leaves_its_figures_its_log_and_its_scene(folder):
    assert set(os.listdir(folder)) == figures("circle_conservative") | {
        "circle_conservative.csv", "circle_conservative.json"}


def test_the_scene_describes_the_run(folder):
    scene = json.loads((folder / "circle_conservative.json").read_text())
    result = summary("run", "circle", "--strategy", "conservative", *SHORT)
    assert [run["strategy"] for run in scene["runs"]] == ["conservative"]
    assert len(scene["obstacles"]) == 3
    one = scene["runs"][0]["summary"]
    assert "wall_s" not in one and "stopped_time_s" in one
    assert one["rms_position_error_m"] == result["rms_position_error_m"]
    assert len(read_log(folder / scene["runs"][0]["log"])[1]) == result["steps"] == 160


def png_size(data):
    """Width and height, with every chunk's checksum verified."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    kinds, place = [], 8
    while place < len(data):
        length, kind = struct.unpack(">I4s", data[place:place + 8])
        body = data[place + 4:place + 8 + length]
        assert struct.unpack(">I", data[place + 8 + length:place + 12 + length])[0] == zlib.crc32(
            body)
        kinds.append(kind)
        place += 12 + length
    assert kinds[0] == b"IHDR" and kinds[-1] == b"IEND"
    return struct.unpack(">II", data[16:24])


@pytest.mark.parametrize("single", SINGLES)
def test_png(folder, single):
    width, height = png_size((folder / f"circle_conservative{single}.png").read_bytes())
    assert width >= 800 and height >= 300


@pytest.mark.parametrize("single", SINGLES)
def test_svg(folder, single):
    root = xml.etree.ElementTree.parse(folder / f"circle_conservative{single}.svg").getroot()
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert len(root.findall(".//{http://www.w3.org/2000/svg}path")) > 10


@pytest.mark.parametrize("single", SINGLES)
def test_pdf(folder, single):
    data = (folder / f"circle_conservative{single}.pdf").read_bytes()
    assert data.startswith(b"%PDF-") and data.rstrip().endswith(b"%%EOF")
    assert b"/Type /Page" in data and b"CreationDate" not in data


def test_figures_are_the_same_every_time(folder, tmp_path):
    summary("run", "circle", "--strategy", "conservative", *SHORT, "--figures", tmp_path)
    for name in sorted(os.listdir(folder)):
        assert (folder / name).read_bytes() == (tmp_path / name).read_bytes(), name


def test_figures_show_the_run(folder, tmp_path):
    """Another run gives other figures: they are not drawn from anything fixed."""
    summary("run", "circle", "--strategy", "conservative", "--set", "duration_s=8", "--set",
            "obstacles.0.x_m=0.12", "--figures", tmp_path)
    for single in SINGLES:
        name = f"circle_conservative{single}.svg"
        assert (folder / name).read_bytes() != (tmp_path / name).read_bytes(), name


def test_compare_lays_runs_over_each_other(tmp_path):
    summary("compare", "eight", "--strategies", "combined,adaptive", *SHORT, "--figures", tmp_path)
    assert set(os.listdir(tmp_path)) == (
        figures("eight_compare") | figures("eight_combined", [""]) | figures("eight_adaptive", [""])
        | {"eight_compare.json", "eight_combined.csv", "eight_adaptive.csv"})
    path = (tmp_path / "eight_compare_path.svg").read_text()
    for colour in ("#0072b2", "#e69f00"):  # one a strategy
        assert colour in path.lower()
    scene = json.loads((tmp_path / "eight_compare.json").read_text())
    assert [run["strategy"] for run in scene["runs"]] == ["combined", "adaptive"]


def test_a_name_that_is_no_file_name_and_a_scene_without_obstacles(tmp_path):
    from test_run import STANDARD
    (tmp_path / "s.yaml").write_text(STANDARD.replace("standard", '"../odd name"'))
    out = tmp_path / "out"
    summary("compare", tmp_path / "s.yaml", "--strategies", "combined,none", "--figures", out)
    assert set(os.listdir(out)) == (
        figures("___odd_name_compare") | figures("___odd_name_combined", [""])
        | figures("___odd_name_none", [""]) | {"___odd_name_compare.json",
                                               "___odd_name_combined.csv", "___odd_name_none.csv"})
    assert sorted(os.listdir(tmp_path)) == ["out", "s.yaml"]


@pytest.mark.parametrize("environment, fragments", [
    ({"BERTH_PLOT_PYTHON": "/nowhere/python"}, ["/nowhere/python", "BERTH_PLOT_PYTHON"]),
    ({"BERTH_PLOT_SCRIPT": "/nowhere/plot.py"}, ["/nowhere/plot.py", "BERTH_PLOT_SCRIPT"]),
])
def test_what_drawing_needs_and_is_missing_is_named(tmp_path, environment, fragments):
    result = sim("run", "circle", "--figures", tmp_path / "out", env=environment)
    assert (result.returncode, result.stdout) == (2, "")
    for fragment in fragments:
        assert fragment in result.stderr
    assert os.listdir(tmp_path) == []


def test_a_folder_that_cannot_be_made_is_2(tmp_path):
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        result = sim("run", "circle", "--figures", path)
        assert (result.returncode, result.stdout) == (2, "")
        assert str(path) in result.stderr


def test_a_plot_script_that_fails_is_1(tmp_path):
    script = tmp_path / "broken.py"
    script.write_text("import sys\nprint('some words')\nsys.exit('it broke')\n")
    result = sim("run", "circle", "--figures", tmp_path / "out", "--json",
                 env={"BERTH_PLOT_SCRIPT": str(script)})
    assert (result.returncode, result.stdout) == (1, "")
    assert "some words" in result.stderr and "it broke" in result.stderr
    assert str(script) in result.stderr
