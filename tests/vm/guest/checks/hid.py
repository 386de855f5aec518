"""Commands of an e-con Tara through the kernel's hidraw, by the Rust host and by Python's hidapi."""

from __future__ import annotations

from guest.checks import Figures, check
from guest.devices import camera
from guest.programs import answers, ended, python_answers, running
from guest.usb.camera import TARA_PRODUCT, TARA_VENDOR, Camera, plugged, wait_for
from guest.usb.tara import Tara


def tara(device: Camera, *commands: str) -> list[dict[str, object]]:
    """Answers of the Rust host."""
    return answers("hid_probe", "tara", "--serial", device.serial, *commands)


@check()
def hid_devices_are_listed_with_serial_and_descriptor() -> None:
    first, second = camera("GS0001", port=0), camera("GS0002", port=1)
    with plugged(first, second):
        devices = [line for line in answers("hid_probe", "list") if "path" in line]
    found = {(device["serial"], device["descriptor_bytes"], device["interface"]) for device in devices}
    assert found == {(serial, *rest) for serial in ("GS0001", "GS0002") for rest in ((29, 2), (23, 3))}, (
        devices
    )
    assert {(device["vendor"], device["product"]) for device in devices} == {(TARA_VENDOR, TARA_PRODUCT)}


@check()
def a_tara_answers_every_command() -> None:
    device = camera("GS0001")
    long_file = bytes(range(32, 127)) * 9
    device.tara.calibration = (long_file, b"")
    with plugged(device):
        commands = ["firmware", "unique_id", "exposure", "exposure=12345", "exposure", "exposure=1", "mode"]
        commands += ["mode=trigger", "hdr", "hdr=1", "calibration=intrinsic", "calibration=extrinsic"]
        found = tara(device, *commands)
    values = [next(iter(line.values())) for line in found]
    expected = ["1.2.3.260", 0xC0FFEE01, 8000, 12345, 12345, 1, "master", "trigger", False, True]
    assert values == [*expected, long_file.decode(), ""], values
    sent = [request[:6].hex() for request in device.tara.requests]
    assert "780200003039" in sent, sent


@check()
def the_right_one_of_two_taras_is_set() -> None:
    first, second = camera("GS0001", port=0), camera("GS0002", port=1)
    with plugged(first, second):
        tara(second, "exposure=4000")
        code, _, error = ended("hid_probe", "tara", "exposure")
    assert (first.tara.exposure_us, second.tara.exposure_us) == (8000, 4000)
    assert code == 2, code
    assert "several HID devices fit" in error and "GS0001" in error and "GS0002" in error, error


@check()
def reports_that_nobody_asked_for_are_passed_over() -> None:
    device = camera("GS0001")
    device.tara.noise = 5
    with plugged(device):
        found = tara(device, "exposure=777", "exposure", "calibration=intrinsic")
    assert found[1] == {"exposure_us": 777}, found
    assert found[2] == {"calibration": device.tara.calibration[0].decode()}, found


def failure(change: Tara, *commands: str) -> str:
    """The error that a camera in this state gives."""
    device = camera("GS0001")
    device.tara = change
    with plugged(device):
        code, _, error = ended("hid_probe", "tara", *commands)
    assert code == 2, (code, error)
    return error


@check()
def a_refused_command_is_named() -> None:
    error = failure(Tara(refuse=True), "exposure=500")
    assert "the camera refuses to set its exposure (status 0; 1 is success)" in error, error


@check()
def a_silent_camera_is_a_timeout() -> None:
    error = failure(Tara(silent=True), "exposure")
    assert "the device did not report its exposure within 2000 ms" in error, error


@check()
def a_camera_unplugged_during_a_command_is_named() -> None:
    device = camera("GS0001")
    device.tara.silent = True
    with plugged(device), running("hid_probe", "tara", "exposure") as run:
        wait_for(lambda: bool(device.tara.requests), "the command")
        device.unplug()
        run.wait_for(lambda run: bool(run.of("error")), "error")
    assert "was unplugged" in run.of("error")[0]["text"], run.lines


@check()
def an_absent_camera_is_named_with_what_is_there() -> None:
    device = camera("GS0001")
    with plugged(device):
        code, _, error = ended("hid_probe", "tara", "--serial", "GS0009", "firmware")
    assert code == 2 and "2560:c114 with serial number GS0009" in error and "GS0001" in error, error


@check(limit_s=120)
def python_reaches_the_camera_by_hidapi() -> Figures:
    device = camera("GS0001")
    device.tara.noise = 2
    with plugged(device):
        found = python_answers(
            """
            with gelstereo.hid.TaraControl.open(serial="GS0001") as camera:
                say(camera.firmware(), camera.unique_id(), camera.exposure_us(), camera.set_exposure_us(2500))
                say(camera.set_stream_mode("trigger"), camera.set_hdr(True), camera.hdr())
                say(camera.calibration("intrinsic").decode())
            try:
                gelstereo.hid.TaraControl.open(serial="GS0009")
            except gelstereo.HidError as error:
                say(str(error))
            """
        )
        by_python = list(device.tara.requests)
        device.tara.requests.clear()
        commands = ["firmware", "unique_id", "exposure", "exposure=2500", "mode=trigger", "hdr=1", "hdr"]
        tara(device, *commands, "calibration=intrinsic")
    absent = found.pop()[0]
    expected = ["1.2.3.260", 0xC0FFEE01, 8000, 2500], ["trigger", True, True]
    assert found == [*expected, [device.tara.calibration[0].decode()]], found
    assert "2560:c114 with serial number GS0009" in absent and "GS0001" in absent, absent
    assert device.tara.requests == by_python, "Rust and Python send different bytes"
    return {"requests": len(by_python)}
