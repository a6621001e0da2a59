"""The measurement itself on a small scene: all stages there, arithmetic and files right."""

import pytest

from diga3d_warp.bench import kernels, page
from diga3d_warp.bench.garden import Garden, Statistics
from diga3d_warp.bench.kernels import Measured, bench_kernels, stage_table, verdicts
from diga3d_warp.bench.stages import OTHERS, PLAIN, RASTERISER, STAGES, WHOLE, Bench
from diga3d_warp.errors import InputError
from diga3d_warp.scene.photographs.images import read_image


def test_every_stage_is_run_and_takes_time():
    bench = Bench(Garden(count=300, width=64, height=48))
    before = bench.optimiser.gaussians().detached()
    seconds = {**bench.stages(2), **bench.whole(2), **bench.plain(2)}
    assert set(seconds) == {*STAGES, WHOLE, *PLAIN}
    assert all(len(times) == 2 and min(times) > 0.0 for times in seconds.values())
    assert sorted(STAGES) == sorted([*RASTERISER, *OTHERS])
    for (name, now), (_, then) in zip(bench.optimiser.gaussians().named(), before.named(), strict=True):
        assert (now - then).abs().max() < 1e-6, f"{name} moved: later repeats draw another scene"


def measured(blend: float) -> Measured:
    """Every other stage 10 ms on one thread, 5 ms on two; ten million pairs."""
    one = {name: [0.012, 0.010] for name in (*STAGES, WHOLE)}
    many = {name: [0.005, 0.009] for name in one} | {"blend": [blend]}
    plain = {name: [0.6, 0.5] for name in PLAIN}
    return Measured(Statistics(900, 10.0, 40_000, 10_000_000), one, many, plain, 2)


def test_verdicts_say_met_or_by_how_much_not():
    rows = {row[0]: row[1:] for row in verdicts(measured(blend=0.005)).rows}
    assert rows["rasterise, forward and backward, 2 threads [s]"] == ("≤ 0.18", "0.02", "met")
    assert rows["forward, a listed pair and core [ns]"] == ("≤ 1.6", "2", "missed by 25 %")
    assert rows["backward, a listed pair and core [ns]"] == ("≤ 3", "2", "met")
    assert rows["rasterise, 2 threads, against the plain kernel on one [times]"] == ("≥ 12", "50.5", "met")
    assert rows["whole step, 2 threads, against the plain kernel on one [times]"] == ("≥ 8", "216", "met")
    assert rows["rasterise, 2 threads against one [times]"] == ("≥ 1.6", "2", "met")
    assert rows["all other stages, in rasterisers [times]"] == ("≤ 1", "1.75", "missed by 75 %")
    slow = {row[0]: row[1:] for row in verdicts(measured(blend=0.025)).rows}
    assert slow["rasterise, 2 threads against one [times]"] == ("≥ 1.6", "1", "missed by 38 %")


def test_stages_show_best_median_gain_and_cost_of_a_pair():
    rows = {row[0]: row[1:] for row in stage_table(measured(blend=0.025)).rows}
    assert rows["project"] == ("10.0", "11.0", "5.0", "7.0", "2.00", "1.00")
    assert rows["rasteriser"] == ("40.0", "44.0", "40.0", "46.0", "1.00", "8.00")
    assert rows["plain blend"] == ("500.0", "550.0", "–", "–", "–", "50.00")


def test_a_page_names_machine_and_command_and_shows_its_plot(tmp_path, monkeypatch):
    monkeypatch.setattr(kernels, "core_count", lambda: 2)
    tables = bench_kernels(tmp_path, 1, Garden(count=300, width=64, height=48))
    text = (tmp_path / "kernels.md").read_text()
    assert f"`diga3d bench kernels --repeats 1 --out {tmp_path}`" in text
    assert "2 cores" in text or "cores" in text
    assert "![kernels](kernels.png)" in text
    assert all(f"**{table.title}**" in text for table in tables)
    assert text.count("| project |") == 1
    plot = read_image(tmp_path / "kernels.png")
    assert plot.shape[1] > 800
    assert plot.std() > 20
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kernels.md", "kernels.png"]


def test_without_the_plots_package_nothing_is_measured(monkeypatch, tmp_path):
    monkeypatch.setattr(page, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'diga3d-warp\[bench\]'"):
        bench_kernels(tmp_path / "out", 1, Garden())
    assert not (tmp_path / "out").exists()
