"""The page in a real browser: `make test-page`.

MVTOP_CLI names the command, MVTOP_SCREENSHOT a picture to write.
"""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

ROOT = Path(__file__).parents[3]
CLI = os.environ.get("MVTOP_CLI", str(ROOT / "target/release/mvtop-cli"))
TOKEN = "0123456789abcdef0123"
BALL = ROOT / "examples/mvball"
PARTS = ROOT / "examples/ycbv4"
# What a prediction may take on a busy machine.
PATIENCE_MS = 60_000


def serve(*args: str):
    """A service on a free port, and its address."""
    command = [CLI, "serve", "--port", "0", *args]
    environment = {k: v for k, v in os.environ.items() if k != "MVTOP_TOKEN"}
    process = subprocess.Popen(
        command, cwd=ROOT, env=environment, stderr=subprocess.PIPE, text=True
    )
    address = ""
    for line in process.stderr:
        if line.startswith("listening on "):
            address = line.split()[-1]
        if line.strip() == "ready":
            return process, address
    raise RuntimeError(f"{command} ended with {process.wait()}")


@pytest.fixture(scope="module")
def browser():
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def ball():
    process, address = serve("--model", "models/mvball", "--rig", "examples/mvball/rig.json")
    yield address
    process.terminate()
    assert process.wait() == 0


@pytest.fixture
def opened(browser: Browser, ball: str):
    """The page, which asks nobody else and complains of nothing."""
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    asked, complaints = [], []
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(ball)
    expect(page.locator("#state")).to_have_text("ready", timeout=PATIENCE_MS)
    # The history comes after the state.
    earlier = len(page.request.get(f"{ball}v1/exposures?after=0").json()["exposures"])
    expect(page.locator("#history button")).to_have_count(earlier, timeout=PATIENCE_MS)
    yield page
    assert [url for url in asked if not url.startswith((ball, "blob:", "data:"))] == []
    assert complaints == []
    page.close()


def send(page: Page, folder: Path, names: list[str]):
    page.set_input_files("#files", [folder / name for name in names])


def shown(page: Page, views: int):
    expect(page.locator("#views figure")).to_have_count(views, timeout=PATIENCE_MS)


def test_images_give_views_poses_and_a_place_in_the_history(opened: Page):
    before = opened.locator("#history button").count()
    send(opened, BALL, ["cam1.png", "cam0.png"])
    expect(opened.locator("#history button")).to_have_count(before + 1, timeout=PATIENCE_MS)
    shown(opened, 2)
    expect(opened.locator("#views figcaption")).to_have_text(["cam0", "cam1"])
    expect(opened.locator("#objects tbody tr")).to_have_count(1)
    expect(opened.locator("#objects tbody")).to_contain_text("mvball")
    expect(opened.locator("#objects tbody")).to_contain_text("%")
    # The outline is in the picture: blue that the image does not have.
    blue = """() => { const c = document.querySelector("#views canvas"); let n = 0;
        const d = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
        for (let i = 0; i < d.length; i += 4)
            if ([86, 180, 233].every((value, k) => Math.abs(d[i + k] - value) < 20)) n++;
        return n; }"""
    assert opened.evaluate(blue) > 50


def test_scene_can_be_turned_by_pointer_and_keys(opened: Page):
    send(opened, BALL, ["cam0.png", "cam1.png"])
    shown(opened, 2)
    picture = lambda: opened.evaluate("document.getElementById('scene').toDataURL()")  # noqa: E731
    first = picture()
    box = opened.locator("#scene").bounding_box()
    opened.mouse.move(box["x"] + 50, box["y"] + 50)
    opened.mouse.down()
    opened.mouse.move(box["x"] + 150, box["y"] + 80)
    opened.mouse.up()
    turned = picture()
    assert turned != first
    opened.mouse.wheel(0, -300)
    assert picture() != turned
    opened.locator("#scene").press("ArrowLeft")
    assert picture() != turned


def test_dropped_images_are_sent(opened: Page):
    before = opened.locator("#history button").count()
    files = {name: list((BALL / name).read_bytes()) for name in ("cam0.png", "cam1.png")}
    opened.evaluate(
        """(files) => { const dropped = new DataTransfer();
        for (const [name, bytes] of Object.entries(files))
            dropped.items.add(new File([new Uint8Array(bytes)], name, { type: "image/png" }));
        const drop = new DragEvent("drop", { dataTransfer: dropped, bubbles: true });
        document.body.dispatchEvent(drop); }""",
        files,
    )
    expect(opened.locator("#history button")).to_have_count(before + 1, timeout=PATIENCE_MS)


def test_what_is_refused_is_said(opened: Page, tmp_path: Path):
    (tmp_path / "cam0.png").write_text("no image")
    send(opened, tmp_path, ["cam0.png"])
    expect(opened.locator("#message")).to_contain_text("none of PNG", timeout=PATIENCE_MS)
    expect(opened.locator("#history button.bad").first).to_be_visible(timeout=PATIENCE_MS)


def test_earlier_exposure_stays_until_the_latest_is_wanted(opened: Page):
    send(opened, BALL, ["cam0.png"])
    shown(opened, 1)
    send(opened, BALL, ["cam0.png", "cam1.png"])
    shown(opened, 2)
    opened.locator("#history button").nth(1).click()
    shown(opened, 1)
    opened.locator("#live").click()
    shown(opened, 2)


def test_tablet_shows_everything_in_its_width(browser: Browser, ball: str):
    page = browser.new_page(viewport={"width": 768, "height": 1024}, has_touch=True)
    page.goto(ball)
    expect(page.locator("#state")).to_have_text("ready", timeout=PATIENCE_MS)
    send(page, BALL, ["cam0.png", "cam1.png"])
    shown(page, 2)
    assert page.evaluate("document.documentElement.scrollWidth") <= 768
    page.close()


def test_form_tries_a_request(browser: Browser, ball: str):
    page = browser.new_page()
    page.goto(ball + "try")
    for camera in ("cam0", "cam1"):
        page.set_input_files(f"[data-camera={camera}]", BALL / f"{camera}.png")
    page.fill("#query", "most=1&frame=world")
    page.click("#send")
    expect(page.locator("#answer")).to_contain_text('"T_frame_obj"', timeout=PATIENCE_MS)
    page.close()


def test_token_is_asked_for_and_parts_are_shown(browser: Browser, tmp_path: Path):
    token = tmp_path / "token"
    token.write_text(TOKEN)
    process, address = serve(
        "--model", "models/ycbv4", "--rig", "examples/ycbv4/rig.json", "--token-file", str(token)
    )
    page = browser.new_page(viewport={"width": 1400, "height": 1000})
    page.goto(address)
    expect(page.locator("#token-form")).to_be_visible(timeout=PATIENCE_MS)
    page.fill("#token", TOKEN)
    page.click("#token-form button")
    expect(page.locator("#token-form")).to_be_hidden(timeout=PATIENCE_MS)
    send(page, PARTS, ["a.jpg", "b.jpg", "c.jpg"])
    shown(page, 3)
    expect(page.locator("#objects tbody tr")).to_have_count(4)
    if picture := os.environ.get("MVTOP_SCREENSHOT"):
        page.screenshot(path=picture, type="jpeg", quality=80)
    page.close()
    process.terminate()
    assert process.wait() == 0
