"""Driving by hand: what keys do, what the terminal shows, and the command."""

import json
import os
import pty
import re
import termios
import threading

import numpy as np
import pytest
from PIL import Image

from racines_data.errors import RacinesError
from racines_envs.driving.keyboard import HELP, KEYS, Drive, Terminal, half_blocks, run, screen
from racines_envs.recordings.episodes import read_recording
from racines_envs.task.actions import ACTIONS
from racines_envs.worlds.making import make_core
from tests.conftest import command
from tests.waiting import PATIENCE


@pytest.fixture
def core(phantom):
    return make_core("SC", 1, phantom=phantom, observation="image", reward="oracle")


def test_every_action_has_one_key_and_every_key_is_named_on_screen():
    assert sorted(KEYS.values()) == sorted(ACTIONS)
    shown = " ".join(HELP)
    for key in KEYS:
        assert re.search(rf"\b{key}\b", shown) if key != " " else "space" in shown, key


def test_keys_move_the_probe_as_the_actions_do(core, phantom):
    drive = Drive(core, seed=5)
    run(drive, ["d", "\x1b[A", "?", "i"])
    assert drive.history[0].actions == [None, *(ACTIONS.index(a) for a in ("+x", "+y", "+rx"))]
    env = make_core("SC", 1, phantom=phantom, observation="params", reward="oracle")
    env.reset(5)
    for action in ("+x", "+y", "+rx"):
        env.step(env.state.seed.new_tensor([ACTIONS.index(action)]))
    assert env.state.position.equal(core.state.position)
    assert env.state.rotation.equal(core.state.rotation)


def test_quitting_new_starts_and_ends(core):
    drive = Drive(core, seed=5)
    first = core.state.position.clone()
    run(drive, "dnddq" + "d" * 9)
    assert int(core.state.steps[0]) == 2
    assert not core.state.position.equal(first)
    core.state.done[:] = True
    assert drive.press("d") and int(core.state.steps[0]) == 2
    assert any("n starts anew" in line for line in drive.words())
    drive.press("n")
    assert int(core.state.steps[0]) == 0 and not bool(core.state.done[0])


def test_the_picture_file_is_renewed_and_episodes_are_recorded(core, tmp_path):
    png = tmp_path / "now.png"
    drive = Drive(core, 1, png, tmp_path / "episodes")
    before = png.read_bytes()
    run(drive, "dwn f")
    assert png.read_bytes() != before
    np.testing.assert_array_equal(np.asarray(Image.open(png)), drive.picture())
    episodes = sorted((tmp_path / "episodes").glob("*.jsonl"))
    assert [len(read_recording(path).steps) for path in episodes] == [3, 3]


def test_half_blocks_show_two_pixels_a_character():
    picture = np.zeros((4, 2, 3), np.uint8)
    picture[0, :] = (255, 0, 0)
    picture[3, 1] = (9, 99, 199)
    lines = half_blocks(picture, 2, 2)
    assert lines[0] == "\x1b[38;2;255;0;0;48;2;0;0;0m▀▀\x1b[0m"
    assert lines[1].endswith("\x1b[38;2;0;0;0;48;2;9;99;199m▀\x1b[0m")
    plain = half_blocks(picture, 2, 2, true_colour=False)
    assert plain[0] == "\x1b[38;5;196;48;5;232m▀▀\x1b[0m"


@pytest.mark.parametrize("size", [(160, 50), (80, 24), (40, 12)])
def test_the_screen_fits_the_terminal(core, size):
    drive = Drive(core)
    columns, rows = size
    lines = screen(drive, columns, rows).split("\r\n")[:-1]
    bare = [re.sub(r"\x1b\[[0-9;]*[A-Za-z]", "", line) for line in lines]
    assert len(lines) <= max(rows, 4 + len(drive.words()))
    assert max(map(len, bare)) < columns
    assert any("step 0 / 200" in line for line in bare)


def test_a_person_at_a_terminal(core, monkeypatch):
    monkeypatch.setenv("COLORTERM", "truecolor")
    person, side = pty.openpty()
    before = termios.tcgetattr(side)
    termios.tcsetwinsize(side, (40, 120))
    seen = bytearray()

    def watch():
        while b"\x1b[?1049l" not in seen:
            seen.extend(os.read(person, 65536))

    watcher = threading.Thread(target=watch, daemon=True)
    drive = Drive(core, seed=2)
    with Terminal(side, side) as terminal:
        watcher.start()
        assert not termios.tcgetattr(side)[3] & (termios.ICANON | termios.ECHO)
        os.write(person, b"d\x1b[Cwq")
        run(drive, terminal.keys(), terminal.show)
    watcher.join(PATIENCE)
    assert not watcher.is_alive()
    assert termios.tcgetattr(side) == before
    assert drive.history[0].actions[1:] == [ACTIONS.index(a) for a in ("+x", "+x", "+y")]
    text = seen.decode()
    assert text.count("\x1b[H") == 4  # the start and three steps
    assert "▀" in text and "step 3 / 200" in text and HELP[0] in text
    for handle in (person, side):
        os.close(handle)


def test_without_a_terminal_it_is_refused():
    reader, writer = os.pipe()
    with pytest.raises(RacinesError, match="needs a terminal"):
        Terminal(reader, writer)
    os.close(reader)
    os.close(writer)


@pytest.mark.slow
def test_the_commands(tmp_path):
    words = ("racines", "drive", "--view", "PL", "--seed", "3")
    refused = command(tmp_path, *words, code=1)
    assert "needs a terminal" in refused.stderr
    done = command(tmp_path, *words, "--keys", "ddwo", "--record", "taken", "--json")
    assert json.loads(done.stdout)["steps"] == 4
    again = command(tmp_path, "racines", "replay", "taken/episode_0000.jsonl", "--json")
    assert json.loads(again.stdout)["steps"] == 4
    assert (tmp_path / "taken/episode_0000.gif").stat().st_size > 1000
