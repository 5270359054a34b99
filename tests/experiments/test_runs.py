"""Run folders: written whole or not at all, never overwritten by chance, and with a record of what made them."""

import contextlib
import json
import os
import stat

import pandas as pd
import pytest

import kerfgym
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.experiments.store import runs, typed
from kerfgym.experiments.store.runs import (
    PACKAGES,
    at_work,
    atomic,
    begun,
    git_state,
    named,
    open_folder,
    record,
    write_json,
    write_table,
)

FRAME = pd.DataFrame({"controller": ["pid", "ü"], "rms": [1.0 / 3.0, float("nan")]})


# ------------------------------------------------------------------------------------------------------------ writing


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "run.json"
    write_json(path, {"old": 1})

    def fails():
        with atomic(path) as part:
            part.write_text("half of the new", encoding="utf-8")
            assert json.loads(path.read_text(encoding="utf-8")) == {"old": 1}
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fails()
    assert json.loads(path.read_text(encoding="utf-8")) == {"old": 1}
    assert os.listdir(tmp_path) == ["run.json"]


def test_data_that_cannot_be_written_leaves_the_old_file(tmp_path):
    write_json(tmp_path / "run.json", {"old": 1})
    with pytest.raises(TypeError):
        write_json(tmp_path / "run.json", {"new": object()})
    assert json.loads((tmp_path / "run.json").read_text(encoding="utf-8")) == {"old": 1}
    assert os.listdir(tmp_path) == ["run.json"]


def test_a_file_appears_under_its_name_only_when_it_is_whole(tmp_path):
    with atomic(tmp_path / "deep" / "film.png") as part:
        part.write_bytes(b"x")
        assert part.parent == tmp_path / "deep"  # the same file system, so the move is one step
        assert not (tmp_path / "deep" / "film.png").exists()
    assert (tmp_path / "deep" / "film.png").read_bytes() == b"x"


def test_a_written_file_may_be_read_by_whoever_may_read_ordinary_ones(tmp_path):
    (tmp_path / "ordinary").write_text("x", encoding="utf-8")
    write_json(tmp_path / "run.json", {})
    assert stat.S_IMODE((tmp_path / "run.json").stat().st_mode) == stat.S_IMODE((tmp_path / "ordinary").stat().st_mode)


def test_a_table_is_the_same_in_both_formats(tmp_path):
    write_table(tmp_path, "runs", FRAME)
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "runs.parquet"), FRAME)
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "runs.csv"), FRAME)
    write_table(tmp_path, "traces", FRAME, csv=False)
    assert sorted(os.listdir(tmp_path)) == ["runs.csv", "runs.parquet", "traces.parquet"]


# ------------------------------------------------------------------------------------------------------------ folders


@pytest.fixture
def finished(tmp_path):
    """The folder of a run that is done."""
    folder = tmp_path / "runs" / "done"
    write_json(folder / "run.json", {})
    write_table(folder, "runs", FRAME)
    (folder / "scenarios").mkdir()
    (folder / "scenarios" / "wavy.toml").write_text("x", encoding="utf-8")
    return folder


@pytest.fixture
def unfinished(tmp_path):
    """The folder of a run that was interrupted."""
    folder = tmp_path / "runs" / "half"
    write_json(folder / "parts" / "0123.json", [])
    return folder


def contents(folder):
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*"))


def test_a_new_folder_is_made_with_its_parents(tmp_path):
    assert open_folder(tmp_path / "runs" / "new").is_dir()
    assert open_folder(tmp_path / "runs" / "new").is_dir()  # there is nothing in it to lose


def test_a_finished_run_is_not_overwritten_unless_told(finished):
    before = contents(finished)
    with pytest.raises(
        InvalidInput, match=r"run folder '.*done' exists; use --overwrite to replace it, or another --name"
    ):
        open_folder(finished)
    assert contents(finished) == before
    open_folder(finished, overwrite=True)
    assert contents(finished) == []


def test_a_finished_run_is_not_resumed_over(finished):
    before = contents(finished)
    with pytest.raises(InvalidInput, match=r"run folder '.*done' is finished; use --overwrite"):
        open_folder(finished, resume=True)
    assert contents(finished) == before


def test_an_interrupted_run_offers_to_be_resumed_and_keeps_its_parts(unfinished):
    with pytest.raises(InvalidInput, match=r"half' exists; use --resume to finish it, --overwrite to replace it"):
        open_folder(unfinished)
    open_folder(unfinished, resume=True)
    assert contents(unfinished) == ["parts", "parts/0123.json"]
    open_folder(unfinished, overwrite=True)
    assert contents(unfinished) == []


def test_a_folder_that_is_not_a_run_is_never_deleted(tmp_path):
    precious = tmp_path / "runs" / "thesis"
    (precious / "chapters").mkdir(parents=True)
    (precious / "chapters" / "1.tex").write_text("years of work", encoding="utf-8")
    for options in ({}, {"overwrite": True}, {"overwrite": True, "resume": True}):
        with pytest.raises(InvalidInput, match=r"thesis' (exists|is not a run folder; it is not overwritten)"):
            open_folder(precious, **options)
    assert (precious / "chapters" / "1.tex").read_text(encoding="utf-8") == "years of work"
    with pytest.raises(InvalidInput, match=r"'.*runs' is not a run folder; it is not overwritten"):
        open_folder(tmp_path / "runs", overwrite=True)


def test_an_empty_folder_that_an_interruption_left_may_be_used_again(tmp_path):
    (tmp_path / "standard").mkdir()
    assert open_folder(tmp_path / "standard", overwrite=True).is_dir()


def test_a_file_in_the_place_of_the_folder_is_named(tmp_path):
    (tmp_path / "standard").write_text("a file", encoding="utf-8")
    for options in ({}, {"overwrite": True}, {"resume": True}):
        with pytest.raises(InvalidInput, match=r"standard' is a file"):
            open_folder(tmp_path / "standard", **options)
    assert (tmp_path / "standard").read_text(encoding="utf-8") == "a file"


def test_what_a_link_in_a_run_folder_points_to_is_not_deleted(finished, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "data").write_text("kept", encoding="utf-8")
    (finished / "link").symlink_to(elsewhere, target_is_directory=True)
    open_folder(finished, overwrite=True)
    assert contents(finished) == []
    assert (elsewhere / "data").read_text(encoding="utf-8") == "kept"


# ------------------------------------------------------------------------------------------------ the same command

BENCHMARK = ("kerfgym", "benchmark", "-s", "my sheet.toml")


@pytest.fixture
def types(tmp_path, monkeypatch):
    """A function: as if this had been typed in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    before = typed.TYPED.set(())
    yield lambda *words: typed.TYPED.set(words)
    typed.TYPED.reset(before)


def interrupted(folder, **options):
    """Begins a run that is killed."""
    with contextlib.suppress(KeyboardInterrupt), at_work(folder, **options):
        write_json(folder / "parts" / "1.json", [])
        raise KeyboardInterrupt


def test_the_same_command_goes_on_and_another_does_not(types, tmp_path, capsys):
    folder = tmp_path / "runs" / "x"
    types(*BENCHMARK, "--overwrite")
    interrupted(folder)
    assert begun(folder) == ["kerfgym benchmark -s 'my sheet.toml'"]
    types(*BENCHMARK, "--seeds", "3")
    with pytest.raises(
        InvalidInput, match=r"x' exists and holds what 'kerfgym benchmark -s 'my sheet.toml'' began; use"
    ):
        open_folder(folder)
    types(*BENCHMARK)
    with at_work(folder):
        assert (folder / "parts" / "1.json").is_file()
        assert "goes on with" in capsys.readouterr().err
        write_json(folder / "run.json", {})
    assert contents(folder) == ["parts", "parts/1.json", "run.json"]
    with pytest.raises(InvalidInput, match="x' exists; use --overwrite"):
        open_folder(folder)


def test_a_program_goes_on_only_if_it_says_so(types, tmp_path):
    interrupted(tmp_path / "x")
    with pytest.raises(InvalidInput, match="x' exists; use --resume"):
        open_folder(tmp_path / "x")
    open_folder(tmp_path / "x", resume=True)


def test_without_a_name_the_same_command_finds_what_it_began(types, tmp_path):
    types(*BENCHMARK)
    first = named(None, "benchmark-")
    interrupted(first)
    assert named(None, "benchmark-") == named(None, resume=True) == first
    with at_work(first):
        assert named(None, "x-") != first  # it is at work at this moment, so this is another run
    types(*BENCHMARK, "--seeds", "3")
    assert named(None, "x-") != first
    with pytest.raises(InvalidInput, match=f"--resume needs --name; unfinished in runs/: {first.name}"):
        named(None, resume=True)
    types(*BENCHMARK)
    with at_work(first):
        write_json(first / "run.json", {})
    assert named(None, "x-") != first


def test_a_command_that_was_killed_after_its_record_comes_to_its_end_with_the_same_command(types, tmp_path, capsys):
    folder = tmp_path / "runs" / "x"
    types(*BENCHMARK)
    interrupted(folder)
    write_json(folder / "run.json", {"figures": 1})
    (folder / ".runs.parquet.a1b2c3d4").write_bytes(b"half of a table")
    types("kerfgym", "benchmark")
    with pytest.raises(InvalidInput, match=r"x' exists and holds what .* began; use --resume to finish it"):
        open_folder(folder)
    types(*BENCHMARK)
    assert named(None, "x-").resolve() == folder
    with at_work(folder, spent=["parts"]):
        assert contents(folder) == [".begun", "parts", "parts/1.json", "run.json"]  # nothing is lost by going on
    assert contents(folder) == ["run.json"]


def test_a_run_is_over_when_the_command_is(types, tmp_path):
    """What it shows at its end is part of it: killed there, the same command shows it."""
    types(*BENCHMARK)
    closing = contextlib.ExitStack()
    before = typed.AFTERWARDS.set(closing)
    with at_work(tmp_path / "x", spent=["parts"]):
        write_json(tmp_path / "x" / "parts" / "1.json", [])
        write_json(tmp_path / "x" / "run.json", {})
    typed.AFTERWARDS.reset(before)
    assert contents(tmp_path / "x") == [".begun", "parts", "parts/1.json", "run.json"]
    with pytest.raises(InvalidInput, match="another command is at work"):
        open_folder(tmp_path / "x")
    closing.close()
    assert contents(tmp_path / "x") == ["run.json"]


def test_a_command_that_was_killed_in_its_first_moment_left_nothing_to_go_on_with(types, tmp_path):
    (tmp_path / "x").mkdir()
    (tmp_path / "x" / ".begun").touch()
    types(*BENCHMARK)
    with at_work(tmp_path / "x"):
        assert begun(tmp_path / "x") == ["kerfgym benchmark -s 'my sheet.toml'"]


@pytest.mark.parametrize("last", ["run.json", "parts"])
def test_overwriting_that_was_killed_may_be_repeated(unfinished, monkeypatch, last):
    """What makes it a run's folder is removed last."""
    write_json(unfinished / "run.json", {})
    (unfinished / "a.csv").touch()
    (unfinished / "z.csv").touch()
    remove, monkeypatched = os.unlink, []

    def dies(path, *rest, **more):
        if os.path.basename(path) == ("0123.json" if last == "parts" else last):
            monkeypatched.append(path)
            raise KeyboardInterrupt
        remove(path, *rest, **more)

    with monkeypatch.context() as patch:
        patch.setattr("os.unlink", dies)
        with pytest.raises(KeyboardInterrupt):
            open_folder(unfinished, overwrite=True)
    assert monkeypatched
    with at_work(unfinished, overwrite=True):
        assert [name for name in contents(unfinished) if name != runs.BEGUN] == []


def test_a_folder_in_which_a_command_is_at_work_is_nobody_elses(types, tmp_path):
    types(*BENCHMARK)
    with at_work(tmp_path / "x"):
        for options in ({}, {"resume": True}, {"overwrite": True}):
            with (
                pytest.raises(InvalidInput, match=r"another command is at work in '.*x'"),
                at_work(tmp_path / "x", **options),
            ):
                pass
    with at_work(tmp_path / "shared", shared=True), at_work(tmp_path / "shared", resume=True, shared=True):
        pass


# ------------------------------------------------------------------------------------------------------------- record


def test_a_run_records_command_versions_and_machine():
    found = record(["kerfgym", "benchmark", "-c", "pid"])
    assert found["command"] == "kerfgym benchmark -c pid"
    assert found["kerfgym"] == kerfgym.__version__
    assert set(found["packages"]) == set(PACKAGES)
    assert {"numpy", "numba", "scipy"} <= set(PACKAGES)
    assert set(found["machine"]) == {"system", "processor", "cores"}
    assert found["python"].count(".") == 2
    json.dumps(found)


def test_outside_a_checkout_there_is_no_git_state(monkeypatch):
    def missing(*arguments, **more):
        raise FileNotFoundError("git")

    monkeypatch.setattr("kerfgym.experiments.store.runs.subprocess.run", missing)
    assert git_state() == {}


@pytest.mark.parametrize("call", ["os.replace", "shutil.rmtree"])
def test_what_is_removed_is_whole_or_gone_whenever_it_is_killed(tmp_path, monkeypatch, call):
    parts = tmp_path / "parts"
    parts.mkdir()
    for name in "abc":
        (parts / name).touch()

    def killed(path, *_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(call, killed)
        with pytest.raises(KeyboardInterrupt):
            runs.discard(parts)
    assert not parts.exists() or len(list(parts.iterdir())) == 3
    runs.sweep(tmp_path)
    runs.discard(parts)  # once more, of what may be gone
    assert not list(tmp_path.iterdir())


def test_files_and_links_are_removed_but_not_what_a_link_leads_to(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "a").touch()
    (tmp_path / "link").symlink_to(tmp_path / "folder")
    (tmp_path / "file").touch()
    for name in ("link", "file"):
        runs.discard(tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]
    assert (tmp_path / "folder" / "a").exists()
