"""The tabs in a browser: sliders, keys, two visitors, an agent. Needs gradio and chromium."""

import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from racines_data.store.frames import open_store
from racines_envs.task.actions import ACTIONS
from racines_leaderboard.studio.parts import Place
from racines_models.generators.nearest_pose import NearestPose
from racines_models.protocol import Run
from tests.leaderboard.studio.conftest import BROWSER_PATIENCE, free_port, open_tab
from tests.leaderboard.studio.test_watching import policy

pytest.importorskip("gradio", reason='needs Gradio: pip install "racines[studio]"')
pytestmark = pytest.mark.docs
TABS = {"generators": "Generators", "probe": "Drive the probe", "agent": "Watch an agent"}


@pytest.fixture(scope="module")
def address(tiny_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The three tabs over a generator and a policy, served."""
    from racines_leaderboard.studio.app import serve

    folder = tmp_path_factory.mktemp("studio")
    run = Run(folder / "runs" / "nearest-pose", progress=False)
    NearestPose().fit(open_store(tiny_root), run)
    policy(folder / "agents" / "seeing")
    place = Place(
        data=tiny_root, runs=folder / "runs", weights=folder / "weights",
        agents=folder / "agents", max_sessions=16,
    )  # fmt: skip
    app = serve(place, port=free_port(), tabs=list(TABS), block=False)
    yield app.local_url.rstrip("/")
    with contextlib.redirect_stdout(None):
        app.close()


@pytest.fixture
def meet(address: str, browser: Any) -> Iterator[Callable[..., Any]]:
    """Open a tab as another visitor; afterwards no page may have reported an error."""
    contexts, errors = [], []

    def opened(tab: str, width: int = 1280, height: int = 900) -> Any:
        context = browser.new_context(viewport={"width": width, "height": height})
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(BROWSER_PATIENCE)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
        page.goto(address)
        page.wait_for_selector("#rc-foot")
        if tab != "generators":
            open_tab(page, TABS[tab])
        return page

    yield opened
    for context in contexts:
        context.close()
    assert not errors


def narrow(page: Any) -> bool:
    """Whether the page needs no scrolling sideways."""
    return page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


def source(page: Any, where: str) -> str:
    return page.locator(f"{where} img").first.get_attribute("src")


def changed(page: Any, where: str, before: str) -> str:
    """Wait until another image is there, and return it."""
    arguments = [f"{where} img", before]
    page.wait_for_function("([at, old]) => document.querySelector(at).src !== old", arg=arguments)
    return source(page, where)


def test_sliders_change_the_images(meet):
    page = meet("generators", 390, 844)
    page.click("#generators-set")
    page.wait_for_selector("#generators-note p")
    page.wait_for_selector("#generators-cards img")
    titles = page.locator("#generators-cards b").all_inner_texts()
    assert titles == ["phantom", "nearest frame", "nearest-pose (run)"]
    slider = page.locator("#generators-position_x input[type=range]")
    before, at = source(page, "#generators-cards"), float(slider.input_value())
    slider.focus()
    for _ in range(4):
        slider.press("ArrowRight")
    assert float(slider.input_value()) != at
    moved = changed(page, "#generators-cards", before)
    page.click("#generators-frame")
    changed(page, "#generators-cards", moved)
    page.wait_for_function(
        "document.querySelector('#generators-cards').innerText.includes('0.0 mm and 0.0°')"
    )
    assert "test split" in page.inner_text("#generators-note") and narrow(page)


def test_keys_and_buttons_drive_the_probe_and_visitors_do_not_meet(meet):
    page, other = meet("probe"), meet("probe", 390, 844)
    for each in (page, other):
        each.click("#probe-start")
        each.wait_for_selector("#probe-image img")
    assert source(page, "#probe-image") == source(other, "#probe-image")
    page.keyboard.press("d")
    expect = "document.querySelector('#probe-image').textContent.includes('{}')"
    page.wait_for_function(expect.format("last: +x"))
    page.keyboard.press("ArrowUp")
    page.wait_for_function(expect.format("last: +y"))
    other.click("#probe-minus-rz")
    other.wait_for_function(expect.format("last: -rz"))
    for words, each in (("step 2 of 200", page), ("step 1 of 200", other)):
        assert words in " ".join(each.inner_text("#probe-image").split())
    assert source(page, "#probe-image") != source(other, "#probe-image")
    assert "true view" not in page.inner_text("#probe-image")
    page.click("#probe-truth input")
    page.wait_for_function(expect.format("true view"))
    page.keyboard.press("o")  # the box that was ticked has the focus, and does not hold the key
    page.wait_for_function(expect.format("last: +rz"))
    page.click("#probe-plus-z")
    page.wait_for_function(expect.format("last: +z"))
    page.keyboard.press(" ")  # stays; does not press the button that was clicked
    page.wait_for_function(expect.format("last: idle"))
    assert "step 5 of 200" in " ".join(page.inner_text("#probe-image").split())
    assert narrow(page) and narrow(other)
    heights = [each.bounding_box()["height"] for each in other.locator(".probe-key").all()]
    assert len(heights) == 13 and min(heights) >= 44  # as large as a thumb


def test_keys_that_are_typed_into_a_field_steer_nothing(meet):
    page = meet("probe")
    page.click("#probe-start")
    page.wait_for_selector("#probe-image img")
    field = page.locator("input[type=number]:visible").first
    field.focus()
    field.press("d")
    page.keyboard.press("Tab")
    page.click("#probe-plus-z")  # events are done in turn: a step of the typed key would be first
    page.wait_for_function(
        "document.querySelector('#probe-image').textContent.includes('last: +z')"
    )
    assert "step 1 of 200" in " ".join(page.inner_text("#probe-image").split())


def test_an_agent_is_watched_with_its_attributions(meet):
    page = meet("agent", 390, 844)
    page.click("#agent-name input")
    page.get_by_role("option", name="seeing").click()
    page.wait_for_function("document.querySelector('#agent-task input').value === 'SC'")
    page.click("#agent-watch")
    page.wait_for_selector("#agent-image img")
    first = source(page, "#agent-image")
    step = page.locator("#agent-step input[type=number]")
    step.fill("5")
    step.press("Enter")
    fifth = changed(page, "#agent-image", first)
    assert "step 5 of 200" in " ".join(page.inner_text("#agent-image").split())
    page.get_by_label("chosen action").check()
    changed(page, "#agent-image", fifth)
    assert "chosen action: p" in page.inner_text("#agent-image") and narrow(page)


def test_many_drive_at_once_and_each_sees_an_episode_of_its_own(address):
    from tests.leaderboard.studio.load import Visitor

    def drive(number: int) -> list[str]:
        visitor, pages = Visitor(address, number), []
        visitor.call("probe_start", "SC", "seed", number, "free", 10_000, False)
        for _ in range(number % 3 + 1):
            pages = visitor.call(f"probe_step_{number}", None, False)
        return pages

    with ThreadPoolExecutor(10) as pool:
        shown = list(pool.map(drive, range(10)))
    for number, pages in enumerate(shown):
        assert f"step <b>{number % 3 + 1}</b>" in pages[1]
        assert f"last: <b>{ACTIONS[number]}</b>" in pages[1]
    assert len({pages[1] for pages in shown}) == 10


@pytest.mark.parametrize(
    ("event", "values"),
    [
        ("probe_start", ["../SC", "seed", 0, "free", 10_000, False]),
        ("probe_start", ["SC", "seed", 2**40, "free", 10_000, False]),
        ("probe_start", ["SC", "evaluation", 100, "free", 10_000, False]),
        ("probe_start", ["SC", "evaluation", 0, "os:path", 10_000, False]),
        ("agent_watch", ["os:system", "SC", 0, "free", 10_000]),
        ("agent_watch", ["planner", "SC", 1000, "free", 10_000]),
        ("probe_start", ["SC-patients", "seed", 0, "free", 15_000, False]),
        ("generators_draw", [0, ["../mean"], *[0] * 12]),
        ("generators_draw", [0, [], "NaN", *[0] * 11]),
        ("generators_set", ["nominal nothing"]),
    ],
)
def test_forged_values_are_refused(address, event, values):
    from tests.leaderboard.studio.load import Visitor

    with pytest.raises(RuntimeError) as refused:
        Visitor(address, 1).call(event, *values)
    assert "Traceback" not in str(refused.value)
