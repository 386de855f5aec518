"""A blink(1) light: what the kernel's own driver hid-led sends, what the host sends, byte for byte."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from guest.checks import Figures, check
from guest.devices import camera
from guest.modules import modprobe
from guest.programs import answers, ended, python_answers, running
from guest.uhid import Blink1
from guest.usb.camera import plugged, wait_for


@contextmanager
def blink1(serial: str = "SN1") -> Iterator[Blink1]:
    """A light with the kernel's driver bound to it."""
    modprobe("uhid", "hid-generic", "hid-led")
    device = Blink1(serial)
    device.plug()
    try:
        wait_for(
            lambda: len(leds()) == 6 and list(Path("/sys/class/hidraw").glob("*")),
            "the six lights of hid-led",
        )
        yield device
    finally:
        device.unplug()
        wait_for(lambda: not leds(), "the lights to vanish")


def leds() -> list[str]:
    """Lights that hid-led has made."""
    return sorted(path.name for path in Path("/sys/class/leds").glob("thingm*"))


def kernel_set(color: str, level: int, device: Blink1) -> bytes:
    """The report that hid-led sends when a colour of its first light is set."""
    count = len(device.reports)
    name = next(led for led in leds() if f":{color}:led0" in led)
    Path("/sys/class/leds", name, "brightness").write_text(str(level), encoding="ascii")
    wait_for(lambda: len(device.reports) > count, "a report of hid-led")
    return device.reports[-1]


@check()
def hid_led_and_the_codec_send_the_same_bytes() -> Figures:
    from gelstereo._native import Blink1Command

    compared = 0
    with blink1() as device:
        color = {"red": 0, "green": 0, "blue": 0}
        for name, level in [
            ("red", 200),
            ("green", 100),
            ("blue", 50),
            ("red", 0),
            ("green", 255),
            ("blue", 1),
        ]:
            color[name] = level
            sent = kernel_set(name, level, device)
            ours = Blink1Command.fade((color["red"], color["green"], color["blue"]), 0, led=1).report
            assert sent == ours, (sent.hex(), ours.hex())
            compared += 1
    return {"reports": compared}


@check()
def the_host_sets_a_blink1_by_hidraw() -> None:
    with blink1() as device:
        commands = ["version", "set=200,100,50", "color", "fade=1,2,3,5000"]
        found = answers("hid_probe", "blink1", "--serial", "SN1", *commands)
        sent = [report.hex() for report in device.reports[-4:]]
    assert found[0] == {"version": [3, 3]} and found[2] == {"color": [200, 100, 50]}, found
    assert sent[1:] == ["016ec8643200000000", "017200000000000000", "016301020301f40000"], sent


@check()
def the_host_sets_a_light_of_the_kernel() -> None:
    with blink1() as device:
        name = next(led for led in leds() if ":red:led0" in led)
        found = answers("hid_probe", "led", name, "0.5")
        wait_for(lambda: device.color[0] == 128, "half of red")
        code, _, error = ended("hid_probe", "led", "thingm9:red:led0", "1")
    assert abs(found[0]["brightness"] - 0.5) < 0.01, found
    assert code == 2 and "thingm9:red:led0" in error and name in error, error


@check()
def the_configured_light_is_on_until_the_end() -> None:
    config = Path("/tmp/cell.toml")
    config.write_text(
        '[light]\nkind = "blink1"\nserial = "SN1"\ncolor = [200, 100, 50]\nbrightness = 0.5\n'
        '[camera_hid]\nkind = "tara"\nexposure_us = 4321\nstream_mode = "trigger"\nhdr = true\n',
        encoding="ascii",
    )
    stereo = camera("GS0001")
    with blink1() as device, plugged(stereo):
        with running("hid_probe", "settings", str(config), interactive=True) as run:
            run.wait_for(lambda run: bool(run.of("on")), "light")
            assert device.color == (100, 50, 25), device.color
            run.end_input()
            run.wait_for(lambda run: bool(run.of("off")), "darkness")
        assert device.color == (0, 0, 0), device.color
    tara = stereo.tara
    assert (tara.exposure_us, tara.stream_mode, tara.hdr) == (4321, 0, 1), tara


@check(limit_s=120)
def sense_lights_the_gel_until_its_end() -> Figures:
    config = Path("/tmp/lit.toml")
    config.write_text(
        '[light]\nkind = "blink1"\nserial = "SN1"\ncolor = [200, 100, 50]\nbrightness = 0.5\n'
        '[sense]\nlocalize = "never"\n[part]\nspacing_mm = 1.0\n',
        encoding="ascii",
    )
    with blink1() as device:
        with running("gelstereo-host", "sense", "--config", str(config), "--jsonl") as run:
            run.wait_for(lambda run: bool(run.lines), "frame of the simulated sensor", limit_s=90.0)
            lit = device.color
        frames = len(run.lines)
        assert lit == (100, 50, 25), lit
        assert device.color == (0, 0, 0), device.color
    return {"frames": frames}


@check(limit_s=120)
def python_sets_a_blink1_by_hidapi() -> None:
    with blink1() as device:
        found = python_answers(
            """
            with gelstereo.hid.Blink1Light.open(serial="SN1") as light:
                say(light.version())
                light.set((9, 8, 7))
                say(light.color())
                light.fade((0, 0, 255), 1000)
                light.off()
            """
        )
        sent = [report.hex() for report in device.reports[-4:]]
    assert found == [[[3, 3]], [[9, 8, 7]]], found
    expected = ["016e09080700000000", "017200000000000000", "01630000ff00640000", "016e00000000000000"]
    assert sent == expected, sent
