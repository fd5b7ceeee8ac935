#!/usr/bin/env python3
"""Opens the page of the corner scene in a real browser, uses it, and looks.

    check_page.py FOLDER [--bounced FOLDER] [--pictures DIR] [--renew]

FOLDER is what `holosonar image tests/data/small/corner.toml` wrote, whose volume the page shows voxel by voxel. Needs
Chromium, and NumPy, OpenEXR and Pillow. `--bounced` names what the same wrote with `--set scene.bounces=1`. The program under test takes no part. `--pictures` leaves screenshots to look at, `--renew` writes the reference picture anew.
"""

import argparse
import io
import re
import tempfile
from pathlib import Path

import numpy as np
import OpenEXR
from browser import Browser
from checks import check, conclude
from PIL import Image

REFERENCE = Path(__file__).with_name("page_reference.png")
COARSE = (64, 45)
MOST_DIFFERENCE = 6.0  # mean of |difference| of 8-bit values


def picture(raw):
    """A PNG's pixels, [y, x, rgb]."""
    return np.asarray(Image.open(io.BytesIO(raw)).convert("RGB")).astype(np.int16)


def changed(before, after):
    """Share of pixels that differ."""
    return (np.abs(before - after).max(axis=2) > 8).mean()


def number(text, pattern):
    """The number that a pattern's group finds, with a true minus sign."""
    found = re.search(pattern, text)
    return float(found.group(1).replace("−", "-")) if found else None


def text(page, selector):
    return page.run(f"document.querySelector('{selector}').textContent")


def middle(page, selector):
    """An element's centre in the window, scrolled into it."""
    place = f"document.querySelector('{selector}')"
    page.run(f"{place}.scrollIntoView({{block: 'center', behavior: 'instant'}})")
    box = page.run(f"(({{x, y, width, height}}) => [x, y, width, height])({place}.getBoundingClientRect())")
    return box[0] + box[2] / 2, box[1] + box[3] / 2


def check_view(page):
    """The volume is drawn, turns, and changes with its controls."""
    stage = picture(page.shot("#stage"))
    background = stage[-20, -20]
    drawn = (np.abs(stage - background).max(axis=2) > 24).mean()
    check("the volume is drawn", 0.03 < drawn < 0.9, f"({drawn:.3f} of the pixels)")
    warm = ((stage[..., 0] > 180) & (stage[..., 2] < 120)).mean()
    check("in the colours of amplitude", warm > 0.01, f"({warm:.4f})")
    x, y = middle(page, "#labels")
    page.mouse("mousePressed", x, y)
    page.mouse("mouseMoved", x + 60, y + 20)
    page.mouse("mouseReleased", x + 60, y + 20)
    page.settle()
    turned = picture(page.shot("#stage"))
    check("dragging turns it", changed(stage, turned) > 0.03)
    page.run("document.querySelector('#labels').focus()")
    before = turned
    for key, what in [("ArrowLeft", "an arrow key turns it"), ("+", "plus zooms"), ("m", "M shows the iso-surface")]:
        page.key(key)
        page.settle()
        after = picture(page.shot("#stage"))
        check(what, changed(before, after) > 0.02, f"({changed(before, after):.4f})")
        before = after
    check("the radio button follows the key", page.run("document.querySelector('[value=surface]').checked"))
    for selector, value, what in [("#threshold", -25, "the level moves the surface"), ("#opacity", 30, "opacity counts")]:
        slide(page, selector, value)
        page.settle()
        after = picture(page.shot("#stage"))
        check(what, changed(before, after) > 0.01, f"({changed(before, after):.4f})")
        before = after
    for key in ("m", "Home"):
        page.key(key)
    slide(page, "#opacity", 100)
    page.run("document.activeElement.blur()")
    page.settle()
    check("Home brings back the first view", changed(stage, picture(page.shot("#stage"))) < 0.005)
    boxes = "document.querySelectorAll('#layers input')"
    names = page.run(f"[...{boxes}].map((box) => box.parentElement.textContent)")
    wanted = {"Reflectors of the scene", "Depths found", "Microphones", "Speaker", "Planes of the slices"}
    mesh = {name for name in names if name.startswith("Mesh")}
    check("reflectors, depths, mesh, microphones and speaker can be drawn", mesh and set(names) - mesh == wanted, str(names))
    for i, name in enumerate(names):
        before = picture(page.shot("#stage"))
        page.run(f"{boxes}[{i}].click()")
        page.settle()
        share = changed(before, picture(page.shot("#stage")))
        check(f"{name}: the box counts", share > (0.02 if name in mesh else 1e-5), f"({share:.5f})")
        page.run(f"{boxes}[{i}].click()")
        page.settle()


def check_bounces(page, html):
    """What echoes of several surfaces add is shown, and hidden where the user wants."""
    page.open(html)
    page.settle()
    box = "[...document.querySelectorAll('#layers label')].find((label) => label.textContent.startsWith('Multipath')).firstChild"
    shown = picture(page.shot("#stage"))
    check("multipath is marked where it is seen", page.run(f"{box}.checked"))
    page.run(f"{box}.click()")
    page.settle()
    hidden = picture(page.shot("#stage"))
    share = changed(shown, hidden)
    # What goes is pink: it has more red and blue than green.
    red, green, blue = (shown - hidden)[np.abs(shown - hidden).max(axis=2) > 8].mean(axis=0)
    pink = min(red, blue) > 1.5 * abs(green)
    check("the page can hide it", not page.run(f"{box}.checked") and share > 0.003 and pink, f"({share:.4f}, {red:.0f} {green:.0f} {blue:.0f})")
    page.run(f"{box}.click()")
    page.settle()
    check("and show it again", changed(shown, picture(page.shot("#stage"))) < 0.005)


def press(page, key):
    """Presses a key in the 3-D view, and gives the picture after it."""
    page.run("document.querySelector('#labels').focus()")
    page.key(key)
    page.run("document.activeElement.blur()")
    page.settle()
    return picture(page.shot("#stage"))


def check_front(page):
    """From the front the array is not drawn over the scene, unless its box is ticked."""
    box = "[...document.querySelectorAll('#layers label')].find((label) => label.textContent === 'Microphones').firstChild"
    blue = lambda stage: ((stage[..., 2] > 180) & (stage[..., 2] - stage[..., 1] > 50)).mean()  # noqa: E731
    oblique = press(page, "Home")
    check("the oblique view shows the microphones", page.run(f"{box}.checked") and blue(oblique) > 0.001, f"({blue(oblique):.4f})")
    front = press(page, "1")
    check("the view from the front hides them", not page.run(f"{box}.checked") and blue(front) < 1e-4, f"({blue(front):.5f})")
    again = press(page, "Home")
    check("the oblique view shows them again", page.run(f"{box}.checked") and changed(oblique, again) < 0.005)
    alone = press(page, "f")
    check("the frame of the volume alone hides them", not page.run(f"{box}.checked") and blue(alone) < 1e-4)
    press(page, "f")
    press(page, "1")
    page.run(f"{box}.click()")
    ticked = press(page, "1")
    check("ticking the box shows them from the front", blue(ticked) > 0.001, f"({blue(ticked):.4f})")
    press(page, "Home")
    check("and from everywhere", page.run(f"{box}.checked"))
    page.run(f"{box}.click()")
    press(page, "Home")
    check("they stay hidden where the user hides them", not page.run(f"{box}.checked"))
    page.run(f"{box}.click()")


def check_section(page, volume):
    """A section takes away what is on one side of it, from all that is drawn of the scene, and moves with the slices."""
    only = {"volume": [], "points": ["Reflectors of the scene"], "depths": ["Depths found"], "mesh": ["Mesh"]}
    tick = lambda names: page.run(  # noqa: E731
        "document.querySelectorAll('#layers label').forEach((label) => { const wanted = "
        f"{names}.some((name) => label.textContent.startsWith(name)); const box = label.querySelector('input'); "
        "if (box.checked !== wanted) box.click(); })"
    )
    slide(page, "#slice-x", 20)
    # Of the pixels drawn without a section, those that differ from the background.
    drawn = lambda stage: np.abs(stage - stage[-20, -20]).max(axis=2) > 24  # noqa: E731
    for what, names in only.items():
        tick(names)
        for mode in ["maximum", "surface"] if what == "volume" else ["maximum"]:
            page.run(f"document.querySelector('[value={mode}]').click()")
            # The volume itself is left out beside layers, by a threshold that nothing reaches.
            slide(page, "#threshold", -15 if what == "volume" else -1)
            none = press(page, "Home")
            whole, kept = drawn(none), []
            press(page, "x")
            check("the radio button of the section follows the key", page.run("document.querySelector('[name=section][value=x]').checked"))
            kept.append(drawn(press(page, "Home")))
            kept.append(drawn(press(page, "s")))
            shares = [(part & whole).sum() / whole.sum() for part in kept]
            check(f"{what} ({mode}): a section cuts it", all(share < 0.9 for share in shares), str(shares))
            check(f"{what} ({mode}): each side has its part", changed(*(np.repeat(part[..., None] * 255, 3, 2) for part in kept)) > 0.003)
            press(page, "s")
            back = press(page, "x")
            check(f"{what} ({mode}): without a section it is whole", changed(none, back) < 0.002, f"({changed(none, back):.4f})")
    page.run("document.querySelector('[value=maximum]').click()")
    slide(page, "#threshold", -25)
    tick(["Reflectors", "Microphones", "Speaker"])
    disabled = "document.querySelector('#section-at').disabled"
    check("without a section its slider rests", page.run(disabled))
    page.run("document.querySelector('[name=section][value=z]').click()")
    page.settle()
    before = picture(page.shot("#stage"))
    check("with a section its slider moves", not page.run(disabled))
    slide(page, "#section-at", 90)
    page.settle()
    z = volume["z"][90]
    said = number(text(page, "#section-value"), r"z ≥ ([\d.]+)")
    check("the section is where its slider says", said is not None and abs(said - z) < 6e-4, f"({said}, {z})")
    check("the slider of the section moves it", changed(before, picture(page.shot("#stage"))) > 0.005)
    check("and the slice with it", page.run("document.querySelector('#slice-z').value") == "90")
    slide(page, "#slice-z", 40)
    page.settle()
    check("the slice moves the section", page.run("document.querySelector('#section-at').value") == "40")
    press(page, ".")
    check("a full stop moves the section by a voxel", page.run("document.querySelector('#section-at').value") == "41")
    before = picture(page.shot("#stage"))
    page.run("document.querySelector('#section-turned').click()")
    page.settle()
    check("the box swaps the sides of the section", changed(before, picture(page.shot("#stage"))) > 0.005)
    check("and says so", "≤" in text(page, "#section-value"))
    page.run("document.querySelector('#section-turned').click()")
    page.run("document.querySelector('[name=section][value=none]').click()")
    press(page, "Home")


def slide(page, selector, value):
    page.run(f"(s => {{ s.value = {value}; s.dispatchEvent(new Event('input')); }})(document.querySelector('{selector}'))")


def check_slices(page, volume):
    """The sliders move the slices, and the read-out says what volume.npz holds."""
    decibels = np.abs(volume["samples"])
    decibels = 20 * np.log10(decibels / decibels.max())
    shape = dict(zip("zyx", decibels.shape))
    for axis, at in [("z", 60), ("y", 20), ("x", 11)]:
        before = picture(page.shot("#slice-plots"))
        slide(page, f"#slice-{axis}", at)
        page.settle()
        check(f"the slider of {axis} moves a slice", changed(before, picture(page.shot("#slice-plots"))) > 0.005)
        most = page.run(f"Number(document.querySelector('#slice-{axis}').max)")
        check(f"the slider of {axis} reaches the last voxel", most == shape[axis] - 1, f"({most})")
    said = text(page, "#slice-read")
    place = [number(said, rf"{axis} (−?[\d.]+)") for axis in "zyx"]
    true = [volume[axis][at] for axis, at in [("z", 60), ("y", 20), ("x", 11)]]
    check("the read-out says where", np.allclose(place, true, atol=6e-4), f"({said}; {true})")
    check_decibels(said, decibels[60, 20, 11])
    k, j, i = np.unravel_index(decibels.argmax(), decibels.shape)
    for axis, at in [("z", k), ("y", j), ("x", i)]:
        slide(page, f"#slice-{axis}", int(at))
    check_decibels(text(page, "#slice-read"), 0.0)


def check_decibels(said, true):
    found = number(said, r": (−?[\d.]+) dB")
    if true < -39.9:
        check("the read-out says that it is weak", "below −40 dB" in said, said)
    else:
        check("the read-out says how much", found is not None and abs(found - true) < 0.14, f"({said}; {true:.2f})")


def check_maps(page, found, truth):
    """Pointing at the depth map says what depth.exr and truth.exr hold."""
    canvas = "#map-plots figure:first-child canvas"
    x, y = middle(page, canvas)
    page.mouse("mouseMoved", x, y - 30)
    page.settle()
    said = text(page, "#map-read")
    header, channels = found
    place = [number(said, rf"{axis} (−?[\d.]+)") for axis in "xy"]
    check("the read-out of the maps says where", None not in place, said)
    first = [float(header[f"sonar:{name}"]) for name in ("x0", "y0")]
    pitch = [float(header[f"sonar:{name}"]) for name in ("pitch", "pitchY")]
    column, row = (round((p - f) / d) for p, f, d in zip(place, first, pitch))
    z, true = channels["Z"][row, column], truth["Z"][row, column]
    check("it says the depth found", abs(number(said, r"found ([\d.]+)") - z) < 6e-4, f"({said}; {z})")
    check("it says the true depth", abs(number(said, r"true ([\d.]+)") - true) < 6e-4, f"({said}; {true})")
    error = number(said.replace("+", ""), r"error (−?[\d.]+)")
    check("it says the error", abs(error - 1e3 * (z - true)) < 0.06, f"({said}; {1e3 * (z - true)})")
    confidence = channels["confidence.V"][row, column]
    check("it says the confidence", abs(number(said, r"confidence (−?[\d.]+)") - confidence) < 0.06, said)
    before = picture(page.shot("#map-plots"))
    page.run("document.querySelector('#shaded').click()")
    page.settle()
    check("the maps are shaded or not", changed(before, picture(page.shot("#map-plots"))) > 0.01)
    page.run("document.querySelector('#shaded').click()")
    check_returns(page, channels, (row, column))
    shots = [picture(page.shot(f"#map-plots figure:nth-child({k})")) for k in (1, 2, 3)]
    page.run("document.querySelector('#shaded').click()")
    page.settle()
    for k, name, counts in [(1, "the depth found", True), (2, "the true depth", True), (3, "the error", False)]:
        share = changed(shots[k - 1], picture(page.shot(f"#map-plots figure:nth-child({k})")))
        check(f"{name} is {'shaded' if counts else 'not shaded'}", (share > 0.05) == counts, f"({share:.4f})")
    page.run("document.querySelector('#shaded').click()")
    page.run(f"document.querySelector('{canvas}').focus()")
    there = number(text(page, "#map-read"), r"x (−?[\d.]+)")
    page.key("ArrowRight")
    moved = number(text(page, "#map-read"), r"x (−?[\d.]+)")
    check("an arrow key moves the read-out", abs(moved - there - pitch[0]) < 2e-3, f"({moved}, {there})")


def check_returns(page, channels, pixel):
    """The maps show the return that is chosen: depth, error and confidence of each pixel."""
    names = page.run("[...document.querySelectorAll('#returns label')].map((label) => label.textContent)")
    check("strongest, first and second return can be chosen", names == ["Strongest", "First", "Second"], str(names))
    row, column = pixel
    second = np.isfinite(channels["return2.Z"])
    # The nearest pixel with two returns, of which the second is not the picked one.
    other = np.argwhere(second & (channels["return2.Z"] != channels["Z"]))
    at = other[np.abs(other - [row, column]).sum(axis=1).argmin()]
    canvas = "#map-plots figure:first-child canvas"
    box = page.run(f"(({{x, y, width, height}}) => [x, y, width, height])(document.querySelector('{canvas}').getBoundingClientRect())")
    # The axes take 46 pixels at the left and 8 at the right, 4 above and 36 below.
    x = box[0] + 46 + (box[2] - 54) * (at[1] + 0.5) / second.shape[1]
    y = box[1] + 4 + (box[3] - 40) * (at[0] + 0.5) / second.shape[0]
    page.mouse("mouseMoved", x, y)
    before = None
    for value, name in enumerate(["picked", "return1", "return2"]):
        page.run(f"document.querySelectorAll('[name=return]')[{value}].click()")
        page.settle()
        prefix = "" if name == "picked" else f"{name}."
        z = channels[f"{prefix}Z"][tuple(at)]
        said = text(page, "#map-read")
        check(f"the read-out says the depth of {name}", abs(number(said, r"found ([\d.]+)") - z) < 6e-4, f"({said}; {z})")
        confidence = channels["confidence.V" if name == "picked" else f"{name}.confidence"][tuple(at)]
        check(f"and its confidence: {name}", abs(number(said, r"confidence (−?[\d.]+)") - confidence) < 0.06, f"({said}; {confidence})")
        true = number(said, r"true ([\d.]+)")
        error = number(said.replace("+", ""), r"error (−?[\d.]+)")
        if true is not None:
            check(f"and its error: {name}", abs(error - 1e3 * (z - true)) < 1.1, f"({said}; {z})")
        maps = picture(page.shot("#map-plots"))
        if name == "return2":
            check("the second return has maps of its own", changed(before, maps) > 0.05, f"({changed(before, maps):.4f})")
        before = maps
    box = "[...document.querySelectorAll('#layers label')].find((label) => label.textContent === 'Depths found').firstChild"
    page.run(f"{box}.click()")
    page.settle()
    stage = picture(page.shot("#stage"))
    page.run("document.querySelectorAll('[name=return]')[0].click()")
    page.settle()
    check("the 3-D view shows the points of the return", changed(stage, picture(page.shot("#stage"))) > 1e-3)
    page.run(f"{box}.click()")
    page.run(f"document.querySelector('{canvas}').scrollIntoView({{block: 'center', behavior: 'instant'}})")


def check_words(page, folder):
    """What the report says is on the page."""
    whole = page.run("document.body.innerText")
    for words in ["8 bits", "−40", "reflectors are drawn", "found − true", "Run file, resolved", "Against the truth"]:
        check(f"the page says `{words}`", words in whole)
    for name, words in [("#tiles", "completeness"), ("#warning-list", "alias"), ("#tables", "reconstruct")]:
        check(f"{name} holds `{words}`", words in text(page, name))
    unlabelled = "[...document.querySelectorAll('input, select, button, canvas')].filter((e) => e.id !== 'scene' && !e.labels?.length && !e.ariaLabel && !e.textContent).length"
    check("every control has a name", page.run(unlabelled) == 0)
    check("the title is the scene's", page.run("document.title") == "corner · holosonar")


def check_reference(page, renew):
    """The first screen, coarsely, against a picture that was looked at."""
    shot = Image.open(io.BytesIO(page.shot())).convert("RGB").resize(COARSE, Image.Resampling.BOX)
    if renew:
        shot.save(REFERENCE, optimize=True)
        return
    reference = np.asarray(Image.open(REFERENCE).convert("RGB")).astype(np.int16)
    difference = np.abs(np.asarray(shot).astype(np.int16) - reference)
    check("the first screen looks as it did", difference.mean() < MOST_DIFFERENCE, f"({difference.mean():.2f})")
    blank = np.abs(reference - np.median(reference, axis=(0, 1))).mean()
    check("a blank page would be noticed", blank > 2 * MOST_DIFFERENCE, f"({blank:.2f})")


def check_hardship(page, html):
    """Without WebGL the rest still works; a page cut short says so."""
    script = "HTMLCanvasElement.prototype.getContext = (old => function (kind, ...rest) { return kind === 'webgl2' ? null : old.call(this, kind, ...rest); })(HTMLCanvasElement.prototype.getContext);"
    number = page.send("Page.addScriptToEvaluateOnNewDocument", source=script)["identifier"]
    page.send("Page.navigate", url=html.resolve().as_uri())
    page.wait("document.documentElement?.dataset.ready === 'true'")
    check("without WebGL the page says so", "3-D view cannot be drawn" in text(page, "#trouble"))
    slide(page, "#slice-z", 30)
    check("and there is nothing to cut", page.run("document.querySelector('#section').disabled"))
    check("and its slices work", "z" in text(page, "#slice-read"))
    page.send("Page.removeScriptToEvaluateOnNewDocument", identifier=number)
    check("no complaints on the way", not page.problems, str(page.problems))
    whole = html.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        damaged = Path(folder) / "damaged.html"
        damaged.write_text(re.sub(r'("depth":")[^"]{40}', r"\1", whole), encoding="utf-8")
        page.send("Page.navigate", url=damaged.resolve().as_uri())
        page.wait("document.querySelector('#trouble') && !document.querySelector('#trouble').hidden")
        check("damaged data are noticed", page.problems and "cannot be shown" in text(page, "#trouble"))


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("folder", type=Path)
    options.add_argument("--bounced", type=Path)
    options.add_argument("--pictures", type=Path)
    options.add_argument("--renew", action="store_true")
    options = options.parse_args()
    html = options.folder / "report.html"
    with np.load(options.folder / "volume.npz") as file:
        volume = {name: file[name] for name in file.files}
    maps = []
    for name in ("depth.exr", "truth.exr"):
        file = OpenEXR.File(str(options.folder / name), separate_channels=True)
        header = {key: np.asarray(value).reshape(-1)[0] for key, value in file.header().items() if key.startswith("sonar:")}
        maps.append((header, {key: channel.pixels for key, channel in file.channels().items()}))
    size = html.stat().st_size
    check("the page is of sane size", 5e4 < size < 4e6, f"({size} bytes)")
    with Browser() as page:
        page.open(html)
        page.settle()
        check_reference(page, options.renew)
        check_words(page, options.folder)
        check_front(page)
        page.open(html)
        check_view(page)
        check_section(page, volume)
        check_slices(page, volume)
        check_maps(page, maps[0], maps[1][1])
        check("no complaints, nothing loaded", not page.problems, str(page.problems))
        for name, width, height, dark in [
            ("laptop", 1440, 900, False), ("laptop_dark", 1440, 900, True), ("phone", 390, 844, False),
            ("phone_dark", 390, 844, True), ("tablet", 800, 1100, False),
        ]:  # fmt: skip
            page.open(html, width, height, dark)
            page.settle()
            over = page.run("document.documentElement.scrollWidth - innerWidth")
            check(f"{name}: nothing is wider than the window", over <= 0, f"({over} px)")
            shot = picture(page.shot())
            check(f"{name}: the theme counts", (shot[5, 5].mean() < 80) == dark, str(shot[5, 5]))
            cut = page.run("[...document.querySelectorAll('figure canvas')].filter((c) => c.getBoundingClientRect().right > c.parentElement.getBoundingClientRect().right).length")
            check(f"{name}: the maps fit their frames", cut == 0, f"({cut} do not)")
            if options.pictures:
                options.pictures.mkdir(parents=True, exist_ok=True)
                (options.pictures / f"{name}.png").write_bytes(page.shot(whole=True))
        check("no complaints in any window", not page.problems, str(page.problems))
        if options.bounced:
            check_bounces(page, options.bounced / "report.html")
        check_hardship(page, html)
    conclude()


if __name__ == "__main__":
    main()
