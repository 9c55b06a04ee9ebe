"""The folder of a campaign: damage is noticed and repaired, full disks lose nothing."""

from __future__ import annotations

import errno
import io
import json
import os
import time
from pathlib import Path

import numpy as np
import pytest
from toys import KINDS, UNITS, Gonio, assert_same, content, index

from gonio.campaign import running
from gonio.campaign.status import status
from gonio.campaign.store import CampaignStore, DamagedError, pack, unpack, write_durably
from gonio.campaign.sweep import Campaign
from gonio.campaign.units import Plan
from gonio.toml_files import InputError


def test_no_flipped_bit_goes_unnoticed() -> None:
    """A unit's file either gives what was written or is told to be damaged; cut short, it always is."""
    random = np.random.default_rng(1)
    arrays = {"a": random.integers(0, 1 << 40, (3, 40)), "b": np.array([1 << 63], np.uint64)}
    whole, seen = pack({"unit": "x"}, arrays), 0
    assert whole == pack({"unit": "x"}, arrays)
    for place in range(len(whole)):
        harmed = bytearray(whole)
        harmed[place] ^= 1 << int(random.integers(8))
        try:
            note, found = unpack(bytes(harmed))
        except DamagedError:
            seen += 1
        else:
            assert note == {"unit": "x"}
            assert {name: array.tolist() for name, array in found.items()} == {n: a.tolist() for n, a in arrays.items()}
    assert seen > 0.8 * len(whole)
    for length in range(0, len(whole), 7):
        with pytest.raises(DamagedError):
            unpack(whole[:length])


def test_a_checksum_is_noticed_that_zip_does_not_notice() -> None:
    """A file that another program put together anew, with other numbers, is no unit."""
    good = dict(np.load(io.BytesIO(pack({"unit": 1}, {"a": np.arange(5)}))))
    content = io.BytesIO()
    np.savez(content, **{**good, "a": np.arange(1, 6)})
    with pytest.raises(DamagedError, match="checksum"):
        unpack(content.getvalue())


def harm(path: Path) -> list[str]:
    """Damage three units in different ways; their names."""
    files = sorted(path.glob("units/*.npz"))
    cut, zeros, swapped, other = files[0], files[5], files[9], files[10]
    cut.write_bytes(cut.read_bytes()[:-100])
    zeros.write_bytes(bytes(zeros.stat().st_size))
    swapped.write_bytes(other.read_bytes())
    return [file.stem for file in (cut, zeros, swapped)]


def test_verify_finds_what_is_damaged_and_the_next_run_repairs_it(run: Gonio, copied: Path, finished: Path) -> None:
    harmed = harm(copied)
    code, out, err = run("verify", str(copied))
    assert code == 1
    assert out == f"{UNITS - 3} units are sound.\n"
    for name in harmed:
        assert f"{name} is damaged" in err
    assert "under a wrong name" in err
    assert err.endswith("3 units were damaged: run the campaign again, which computes them.\n")
    code, out, _ = run("run", "toy.toml", "-o", str(copied))
    assert (code, out.startswith(f"{UNITS} units: {UNITS - 3} were there, 3 computed")) == (0, True)
    assert run("verify", str(copied)) == (0, f"{UNITS} units are sound.\n", "")
    assert_same(copied, finished)


def test_merge_finds_what_is_damaged(run: Gonio, copied: Path, finished: Path) -> None:
    harmed = harm(copied)
    code, _, err = run("merge", str(copied))
    assert code == 1
    assert all(f"{name} is damaged" in err for name in harmed)
    assert "experiments lack units: run the campaign again." in err
    rows = index(copied)
    hit = [any(name in entry["units"] for name in harmed) for entry in CampaignStore(copied).manifest()["experiments"]]
    assert [row["file"] == "" for row in rows] == hit
    assert run("run", "toy.toml", "-o", str(copied), "--quiet") == (0, "", "")
    assert_same(copied, finished)


def test_a_damaged_pilot_is_measured_again(tmp_path: Path) -> None:
    experiment = KINDS["a target"]
    campaign = Campaign.of([experiment])
    running.run(campaign, tmp_path)
    before = content(tmp_path)
    pilot, *_ = (unit.pilot for unit in Plan.of(campaign).units[0] if unit.pilot)
    follower = next(unit for unit in Plan.of(campaign).units[0] if unit.pilot == pilot)
    store = CampaignStore(tmp_path)
    (store.units / f"{pilot}.npz").write_bytes(b"nothing")
    (store.units / f"{follower.name}.npz").unlink()
    assert running.run(campaign, tmp_path).computed == 1
    assert content(tmp_path) == before


def test_a_damaged_manifest_is_written_anew(copied: Path, toy: Campaign, finished: Path) -> None:
    (copied / "manifest.json").write_text('{"title')
    with pytest.raises(InputError, match="is damaged: run the campaign again"):
        status(CampaignStore(copied))
    assert running.run(toy, copied).computed == 0
    assert_same(copied, finished)


def test_a_manifest_of_another_format_is_told(copied: Path) -> None:
    manifest = CampaignStore(copied).manifest()
    CampaignStore(copied).manifest_file.write_text(json.dumps(manifest | {"format_version": 7}))
    with pytest.raises(InputError, match=r"its format_version is 7, and this gonio reads 1: run the campaign again"):
        status(CampaignStore(copied))


def test_a_full_disk_is_one_sentence_and_loses_nothing(
    run: Gonio, finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        sync, calls = os.fsync, list[int]()

        def full(handle: int) -> None:
            calls.append(handle)
            if len(calls) > 12:
                raise OSError(errno.ENOSPC, "anything")
            sync(handle)

        patch.setattr("os.fsync", full)
        code, out, err = run("run", "toy.toml", "-o", "c")
    assert (code, out) == (1, "")
    assert err == (
        "c cannot be written (no space left on device): finished units are kept, the same command continues.\n"
    )
    kept = len(CampaignStore(Path("c")).finished())
    assert kept == 5  # file and folder are flushed for the manifest and for each unit; not the sixth, half there
    assert not list(Path("c").rglob("*.tmp"))
    code, out, _ = run("run", "toy.toml", "-o", "c")
    assert out.startswith(f"{UNITS} units: {kept} were there, {UNITS - kept} computed")
    assert_same(Path("c"), finished)


def test_a_file_appears_whole_by_a_rename(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace_, seen = Path.replace, list[tuple[bytes, bool]]()

    def watched(self: Path, target: Path) -> Path:
        seen.append((self.read_bytes(), target.exists()))
        return replace_(self, target)

    monkeypatch.setattr(Path, "replace", watched)
    write_durably(tmp_path / "a", b"content")
    assert seen == [(b"content", False)]
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_what_killed_runs_left_half_written_is_removed_after_an_hour(toy: Campaign, tmp_path: Path) -> None:
    store = CampaignStore(tmp_path)
    store.create(Plan.of(toy).manifest())
    old, fresh = store.units / ".a.tmp", store.units / ".b.tmp"
    for path in (old, fresh):
        path.touch()
    os.utime(old, (time.time() - 4000,) * 2)
    store.create(Plan.of(toy).manifest())
    assert (old.exists(), fresh.exists()) == (False, True)
    assert store.finished() == set()
