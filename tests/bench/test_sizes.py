"""Cost against size: each size in a process of its own, growth judged against pairs."""

import pytest

from diga3d_warp.bench import sizes
from diga3d_warp.bench.sizes import Series, Size, bench_sizes, growth_table, memory_table, run_size
from diga3d_warp.errors import InputError
from diga3d_warp.scene.photographs.images import read_image


def made_up(count: int, width: int, height: int, slower: float = 1.0) -> Size:
    """A pair takes 1 ns, a gaussian 1000 bytes beside 100 MiB, a pixel 50 bytes."""
    pairs = 360 * width * height * count // 120_000
    bytes_taken = 1000 * count + 50 * width * height
    return Size(
        count,
        width,
        height,
        pairs,
        pairs // 2,
        slower * 1e-9 * pairs,
        1e-10 * pairs,
        1e-3,
        100 + round(bytes_taken / 2**20),
    )


def test_growth_is_judged_and_memory_is_that_of_one_more():
    by_count = [made_up(10_000, 648, 420), made_up(1_000_000, 648, 420, slower=0.8)]
    by_image = [made_up(120_000, 384, 260), made_up(120_000, 1760, 1136, slower=1.5)]
    series = [Series("by gaussians", by_count), Series("slower", by_image), Series("by pixels", by_image)]
    rows = {row[0]: row[1:] for row in growth_table(series).rows}
    assert rows["by gaussians"] == ("100.00", "71.38, met", "80.00, met", "100.00")
    assert rows["slower"] == ("20.03", "29.25, missed", "30.04, missed", "20.03")
    gaussian, pixel = (int(row[1]) for row in memory_table(series).rows)
    assert gaussian == pytest.approx(1000, rel=0.01)
    assert pixel == pytest.approx(50, rel=0.02)


def test_page_and_plot_of_all_sizes(monkeypatch, tmp_path):
    asked = []

    def run(count: int, width: int, height: int, repeats: int) -> Size:
        asked.append((count, width, height))
        return made_up(count, width, height)

    monkeypatch.setattr(sizes, "run_size", run)
    tables = bench_sizes(tmp_path, 3)
    assert [len(table.rows) for table in tables] == [5, 4, 4, 3, 2]
    assert len(asked) == len(set(asked)) == 11
    text = (tmp_path / "sizes.md").read_text()
    assert f"`diga3d bench kernels --sizes --repeats 3 --out {tmp_path}`" in text
    assert "| 1,000,000 | 648 x 420 | 816.5 | 408.2 | 816 | 82 | 1 | 817 | 1.00 | 2.00 |" in text
    assert "| 120,000 | 1760 x 1136 |" in text and "| 881,552 | 1760 x 1136 |" in text
    assert read_image(tmp_path / "sizes.png").std() > 15


def test_a_size_is_measured_in_a_process_of_its_own():
    size = run_size(20_000, 96, 64, 1)
    assert (size.count, size.width, size.height) == (20_000, 96, 64)
    assert size.listed_pairs > size.blended_pairs > 10 * 96 * 64
    assert 0.0 < size.rasterise < 10.0
    assert 0.0 < size.others < 10.0
    # Parameters, their gradients and two moments alone are 59 floats each.
    assert 4 * 59 * 4 * 20_000 < size.peak_mib * 2**20 < 100_000 * 20_000


def test_a_process_that_dies_is_one_line(capfd):
    with pytest.raises(InputError, match="measuring -5 gaussians at 64 x 64 px ended with code 1"):
        run_size(-5, 64, 64, 1)
    assert "Traceback" in capfd.readouterr().err
