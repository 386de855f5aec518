"""HID devices from Python: bytes of the makers' documents, answers matched, and errors that say what to do.

Devices on real drivers are in tests/vm.
"""

from __future__ import annotations

import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

import gelstereo.hid
from gelstereo import HidError
from gelstereo._native import Blink1Command, TaraAssembly, TaraRequest, hid_udev_rule

REQUESTS = [
    TaraRequest.firmware(),
    TaraRequest.unique_id(),
    TaraRequest.exposure(),
    TaraRequest.set_exposure(8000),
    TaraRequest.stream_mode(),
    TaraRequest.set_stream_mode("master"),
    TaraRequest.hdr(),
    TaraRequest.set_hdr(True),
    TaraRequest.calibration_length("intrinsic"),
    TaraRequest.calibration_data("extrinsic"),
]


def report(start: str) -> bytes:
    """A report of 64 bytes that starts with these."""
    return bytes.fromhex(start).ljust(64, b"\0")


def test_requests_are_the_makers_bytes() -> None:
    starts = ["40", "41", "7801", "780200001f40", "780c", "780b01", "780f", "780e01", "7809", "780a01"]
    assert [request.report for request in REQUESTS] == [report(start) for start in starts]
    assert [request.timeout_s for request in REQUESTS] == [2.0] * 8 + [5.0] * 2


def test_answers_are_read() -> None:
    answers = [
        (TaraRequest.firmware(), "40 01 02 0003 0104", "1.2.3.260"),
        (TaraRequest.unique_id(), "41 c0ffee01", 0xC0FFEE01),
        (TaraRequest.exposure(), "7801 00001f40 00000000 01", 8000),
        (TaraRequest.stream_mode(), "780c 00 00 01", "trigger"),
        (TaraRequest.hdr(), "780f 01 00 01", True),
        (TaraRequest.calibration_length("intrinsic"), "7809 0000000000 0201 000000000000 01", 513),
        (TaraRequest.calibration_data("intrinsic"), "780a 000000 0007 01 aabb", (7, b"\xaa\xbb" + bytes(54))),
    ]
    for request, bytes_, value in answers:
        assert request.decode(report(bytes_)) == value
        assert request.decode(report("7806")) is None


def test_a_refused_command_is_an_error() -> None:
    with pytest.raises(HidError, match=r"the camera refuses to switch HDR \(status 0; 1 is success\)"):
        TaraRequest.set_hdr(True).decode(report("780e 01 00 00"))


@given(st.sampled_from(REQUESTS), st.binary(max_size=70), st.booleans())
def test_any_bytes_are_an_answer_or_none_or_refused(request: TaraRequest, data: bytes, fitting: bool) -> None:
    if fitting:
        data = (request.report[:2] + data).ljust(64, b"\1")[:64]
    try:
        answer = request.decode(data)
    except HidError:
        assert fitting or data[:1] == request.report[:1]
    else:
        assert fitting == (answer is not None) or len(data) == 64


@given(st.binary(max_size=400), st.integers(0, 1))
def test_a_calibration_file_is_put_together_again(data: bytes, first: int) -> None:
    assembly = TaraAssembly(len(data))
    for number, start in enumerate(range(0, len(data), 56), start=first):
        assert not assembly.is_complete
        assembly.push(number, data[start : start + 56].ljust(56, b"\xee"))
    assert assembly.is_complete and assembly.data == data
    with pytest.raises(HidError, match="read the file again"):
        assembly.push(900, bytes(56))


@given(st.tuples(*[st.integers(0, 255)] * 3), st.integers(0, 655_350), st.integers(0, 2))
def test_a_blink1_fade_is_the_documents_bytes(color: tuple[int, int, int], fade_ms: int, led: int) -> None:
    ticks = (fade_ms // 10).to_bytes(2, "big")
    assert Blink1Command.fade(color, fade_ms, led).report == bytes([1, ord("c"), *color, *ticks, led, 0])
    assert Blink1Command.set(color, led).report == bytes([1, ord("n"), *color, 0, 0, led, 0])
    assert Blink1Command.decode_color(bytes([1, ord("r"), *color, 0, 0, 0, 0])) == color


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: TaraRequest.set_exposure(5), "exposure_us is 5; valid is 1 .automatic. or 10 to 1000000 us"),
        (lambda: TaraRequest.set_exposure(-1), "exposure_us is -1; valid is 1"),
        (lambda: TaraRequest.set_exposure(2**40), "exposure_us is 1099511627776; valid is 1"),
        (lambda: TaraRequest.set_stream_mode("slave"), 'mode is "slave"; valid is "master"'),  # type: ignore[arg-type]
        (lambda: TaraRequest.calibration_length("all"), 'file is "all"; valid is'),  # type: ignore[arg-type]
        (lambda: TaraAssembly(9).push(0, b"short"), "data has 5 bytes"),
        (lambda: Blink1Command.set((256, 0, 0)), r"color is \[256, 0, 0\]; valid is three numbers"),
        (lambda: Blink1Command.set((0, 0, 0), 3), "led is 3; valid is 0"),
        (lambda: Blink1Command.fade((0, 0, 0), -1), "fade_ms is -1; valid is 0 to 655350"),
        (lambda: Blink1Command.fade((0, 0, 0), 655_360).report, "fade_ms is 655360; valid is 0 to 655350"),
        (lambda: Blink1Command.decode_version(b"\1v\0x3"), "command 'v' with 5 bytes"),
    ],
)
def test_what_has_no_meaning_is_refused(call: object, words: str) -> None:
    with pytest.raises(HidError, match=words):
        call()  # type: ignore[operator]


def test_an_absent_device_is_named() -> None:
    pytest.importorskip("hidraw", reason="hidapi has no hidraw on this system")
    with pytest.raises(HidError, match=r"there is no HID device 27b8:01ed with serial number none-such"):
        gelstereo.hid.Blink1Light.open(serial="none-such")
    with pytest.raises(HidError, match=r"there is no HID device 2560:c114"):
        gelstereo.hid.TaraControl.open(serial="none-such")


def test_without_hidapi_the_error_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "hidraw", None)
    monkeypatch.setitem(sys.modules, "hid", None)
    with pytest.raises(HidError, match="pip install hidapi"):
        gelstereo.hid.devices()


def test_the_udev_rule_names_the_device() -> None:
    rule = hid_udev_rule(0x27B8, 0x01ED)
    assert 'ATTRS{idVendor}=="27b8", ATTRS{idProduct}=="01ed"' in rule and 'KERNEL=="hidraw*"' in rule
