"""A press of Ctrl-C has its effect whatever the program does when it comes."""

from __future__ import annotations

import signal

import pytest

from tests.support.processes import ctrl_c_here, python
from trajopt.solving.interruption import Interruption

PRESSED = """
import contextlib, os, signal, sys, threading, time
from trajopt.solving.interruption import Interruption, interruptible

def press():
    os.kill(os.getpid(), signal.SIGINT)

"""
# A test waits for what is to happen far below the limit after which it fails.
FOR_EVER = "time.sleep(3600)"


def test_second_press_ends_a_solver_that_does_not_answer() -> None:
    done = python(
        PRESSED
        + f"""
with Interruption() as interruption, interruption.recording():
    interruption.note = ", nothing was written"
    press(), press()
    {FOR_EVER}
"""
    )
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "trajopt: cancelled, nothing was written\n"


def test_press_that_a_library_loses_comes_again() -> None:
    done = python(
        PRESSED
        + f"""
with contextlib.suppress(KeyboardInterrupt), Interruption():
    try:
        press()
        {FOR_EVER}
    except BaseException:
        pass
    {FOR_EVER}
print("ended")
"""
    )
    assert (done.returncode, done.stdout) == (0, "ended\n"), done.stderr


def test_press_that_comes_just_before_a_system_call_interrupts_it() -> None:
    """Another thread takes the signal: the system call of the main thread does not notice it."""
    done = python(
        PRESSED
        + """
read, write = os.pipe()
with contextlib.suppress(KeyboardInterrupt), Interruption():
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    threading.Timer(0.5, press).start()
    os.read(read, 1)
print("ended")
"""
    )
    assert (done.returncode, done.stdout) == (0, "ended\n"), done.stderr


@pytest.mark.long
def test_what_is_cleaned_up_after_a_press_is_cleaned_up_whole() -> None:
    done = python(
        PRESSED
        + f"""
with contextlib.suppress(KeyboardInterrupt), Interruption():
    try:
        press()
        {FOR_EVER}
    finally:
        try:
            raise ValueError
        except ValueError:
            time.sleep(1.0)
        press()
        time.sleep(1.0)
        print("cleaned up")
"""
    )
    assert (done.returncode, done.stdout) == (0, "cleaned up\n"), done.stderr


def test_third_press_ends_a_cleaning_up_that_does_not_end() -> None:
    done = python(
        PRESSED
        + f"""
with Interruption():
    try:
        press()
        {FOR_EVER}
    finally:
        press(), press()
        {FOR_EVER}
"""
    )
    assert (done.returncode, done.stderr) == (130, "trajopt: cancelled\n")


def test_a_recorded_press_is_raised_where_recording_ends() -> None:
    done = python(
        PRESSED
        + """
with Interruption() as interruption:
    try:
        with interruption.recording():
            press()
            print(interruption.pressed)
    except KeyboardInterrupt:
        interruption.answer()
        print("raised", interruption.pressed)
    with interruption.recording():
        press()
        interruption.answer()
    time.sleep(0.5)
    print("answered")
"""
    )
    assert (done.returncode, done.stdout) == (0, "True\nraised False\nanswered\n"), done.stderr


def test_a_press_is_told_whoever_asks() -> None:
    done = python(
        PRESSED
        + """
with interruptible() as outer, outer.recording():
    press()
    with interruptible() as inner:
        print(inner is outer, inner.pressed)
    inner.answer()
    print(outer.pressed)
with interruptible() as other:
    print(other is outer)
"""
    )
    assert (done.returncode, done.stdout) == (0, "True True\nFalse\nFalse\n"), done.stderr


def test_handlers_are_as_before_afterwards() -> None:
    handlers = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGURG)]
    with ctrl_c_here():
        with Interruption():
            assert signal.getsignal(signal.SIGINT) is not signal.default_int_handler
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGURG)] == handlers
    assert signal.set_wakeup_fd(-1) == -1


def test_ctrl_c_that_is_ignored_stays_ignored() -> None:
    done = python(
        PRESSED
        + """
signal.signal(signal.SIGINT, signal.SIG_IGN)
with Interruption() as interruption:
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    press()
    assert not interruption.pressed
assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
"""
    )
    assert done.returncode == 0, done.stderr
