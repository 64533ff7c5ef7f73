"""The studio's page in a real browser without a window, and how the command ends."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from browsers import opened_browser

pytest.importorskip("viser", reason="the studio's page needs pip install 'napsp[studio]'")
pytest.importorskip("mjviser", reason="the studio's page needs pip install 'napsp[studio]'")

PATIENCE = 120  # seconds; a page that is drawn without a GPU on busy cores is slow
TASK = ["--env", "fetch_reach", "--samples", "8", "--threads", "2", "--seed", "0"]  # with a helper process

pytestmark = pytest.mark.slow


class Studio:
    """The command, as a user starts it, in a group of processes of its own."""

    def __init__(self, *arguments):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        command = [sys.executable, "-m", "planners.studio", *TASK, "--port", str(port), *arguments]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                                        start_new_session=True)  # fmt: skip
        self.line = self.process.stdout.readline()
        self.address = f"http://127.0.0.1:{port}"

    def end(self):
        """What it printed after its first line, once it has ended."""
        rest, _ = self.process.communicate(timeout=PATIENCE)
        return rest

    def processes(self):
        """Ids of what is left of the group."""
        found = []
        for name in filter(str.isdigit, os.listdir("/proc")):
            try:
                state, _, group = Path(f"/proc/{name}/stat").read_text().rpartition(")")[2].split()[:3]
            except OSError:  # ended meanwhile
                continue
            if int(group) == self.process.pid and state != "Z":
                found.append(int(name))
        return found


@pytest.fixture
def start():
    made = []

    def begin(*arguments):
        made.append(Studio(*arguments))
        return made[-1]

    yield begin
    for studio in made:
        if studio.process.poll() is None:
            os.killpg(studio.process.pid, signal.SIGKILL)
        studio.process.wait()
        studio.process.stdout.close()


@pytest.fixture(scope="module")
def browser():
    with opened_browser() as opened:
        yield opened


@pytest.fixture
def page(browser):
    opened = browser.new_page(viewport={"width": 640, "height": 360})
    opened.set_default_timeout(1000 * PATIENCE)
    yield opened
    opened.close()


def press(page, name):
    # Playwright's own click waits until nothing moves, which without a GPU takes too long.
    page.get_by_role("button", name=name, exact=True).dispatch_event("click")


def says(page, words):
    page.get_by_text(re.compile(words)).first.wait_for(state="attached")


def test_the_page_shows_no_errors_and_its_controls_act(start, page):
    studio, errors = start(), []
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("requestfailed", lambda request: errors.append(request.url))
    assert studio.line == f"studio: {studio.address} (Ctrl-C ends it)\n"
    page.goto(studio.address)
    says(page, "paused: seed 0, step 0 of 50")
    press(page, "Step")
    says(page, "step 1 of 50")
    says(page, "The simulation waits for its plans: .* of 40 ms")
    press(page, "Run")
    says(page, r"running: seed 0, step \d\d")
    assert page.locator("canvas").count() >= 4  # the scene and three charts
    press(page, "Pause")
    says(page, "paused: ")
    samples = page.get_by_role("textbox").filter(visible=True)
    values = [box.input_value() for box in samples.all()]
    box = samples.nth(values.index("8"))
    box.fill("2")
    box.press("Enter")
    says(page, "--samples is 2; .* give at least 4")
    says(page, "paused: seed 0")
    press(page, "Reset")
    says(page, "seed 0, step 0 of 50")
    page.get_by_role("checkbox").first.dispatch_event("click")
    says(page, "In real time with the newest plan")
    assert not errors
    page.close()
    assert studio.end() == "studio: the page was closed\n"
    assert studio.process.returncode == 0 and not studio.processes()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_leaves_no_process(start, number):
    studio = start("--run")
    assert studio.line.startswith("studio: http://127.0.0.1:")
    end = time.monotonic() + PATIENCE
    while len(studio.processes()) < 2:  # it plans, with its helper
        assert time.monotonic() < end
        time.sleep(0.1)
    studio.process.send_signal(number)
    assert studio.end() == "studio: ended\n"
    assert studio.process.returncode == 0 and not studio.processes()
