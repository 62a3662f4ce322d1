"""A press of Ctrl-C has its effect whatever the program does when it comes."""

import signal

import pytest

from tests.support.processes import ctrl_c_here, python
from trajopt.cli.interruption import Interruption

PRESSED = """
import contextlib, os, signal, sys, threading, time
from trajopt.cli.interruption import Interruption

interruption = Interruption()
def press():
    os.kill(os.getpid(), signal.SIGINT)

"""
# A test waits for what is to happen far below the limit after which it fails.
FOR_EVER = "time.sleep(3600)"


def outcome(code: str) -> tuple[int, str, str]:
    """Exit status, stdout and stderr of a program that presses Ctrl-C itself."""
    done = python(PRESSED + code)
    return done.returncode, done.stdout, done.stderr


def test_a_press_is_a_keyboard_interrupt() -> None:
    code = f"""
with contextlib.suppress(KeyboardInterrupt), interruption.handling():
    threading.Timer(0.1, press).start()
    {FOR_EVER}
print("ended")
"""
    assert outcome(code) == (0, "ended\n", "")


def test_second_press_ends_a_solver_that_does_not_answer() -> None:
    code = f"""
with interruption.handling(), interruption.deferring():
    press(), press()
    {FOR_EVER}
"""
    assert outcome(code) == (130, "", "trajopt: cancelled\n")


# A call of the C library that is not interrupted, and that releases Python's lock as solvers do.
NATIVE = """
import ctypes
signal.siginterrupt(signal.SIGINT, False)
lock = ctypes.CDLL(None).pthread_mutex_lock
mutex = ctypes.create_string_buffer(64)
def forever():
    lock(mutex), lock(mutex)
"""


@pytest.mark.parametrize("state", ["interruption.deferring()", "contextlib.nullcontext()"])
def test_second_press_ends_native_code_that_does_not_return(state: str) -> None:
    code = f"""{NATIVE}
with interruption.handling(), {state}:
    for delay in (0.2, 0.4):
        threading.Timer(delay, press).start()
    forever()
"""
    assert outcome(code) == (130, "", "trajopt: cancelled\n")


def test_a_press_in_a_destructor_is_known_and_not_told_and_other_errors_are() -> None:
    code = """
class Last:
    def __init__(self, do):
        self.do = do
    def __del__(self):
        self.do()
        sum(range(1000))
with contextlib.suppress(KeyboardInterrupt), interruption.handling():
    Last(press)
    print(interruption.pressed)
    interruption.check()
    print("not reached")
with interruption.handling():
    Last(lambda: 1 / 0)
"""
    status, output, errors = outcome(code)
    assert (status, output) == (0, "True\n")
    assert errors.startswith("Exception ignored in")
    assert errors.rstrip().endswith("ZeroDivisionError: division by zero")
    assert errors.count("Exception ignored in") == 1


def test_a_press_that_a_library_loses_is_known_and_a_second_one_is_raised() -> None:
    code = f"""
with contextlib.suppress(KeyboardInterrupt), interruption.handling():
    try:
        press()
        {FOR_EVER}
    except BaseException:
        pass
    print(interruption.pressed)
    press()
    {FOR_EVER}
print("ended")
"""
    assert outcome(code) == (0, "True\nended\n", "")


@pytest.mark.long
def test_what_is_cleaned_up_after_a_press_is_cleaned_up_whole() -> None:
    code = f"""
with contextlib.suppress(KeyboardInterrupt), interruption.handling():
    try:
        press()
        {FOR_EVER}
    finally:
        try:
            raise ValueError
        except ValueError:
            time.sleep(0.3)
        press()
        time.sleep(0.3)
        print("cleaned up")
"""
    assert outcome(code) == (0, "cleaned up\n", "")


def test_third_press_ends_a_cleaning_up_that_does_not_end() -> None:
    code = f"""
with interruption.handling():
    try:
        press()
        {FOR_EVER}
    finally:
        press(), press()
        {FOR_EVER}
"""
    assert outcome(code) == (130, "", "trajopt: cancelled\n")


def test_a_deferred_press_is_raised_where_deferring_ends() -> None:
    code = """
with interruption.handling():
    try:
        with interruption.deferring():
            press()
            print(interruption.pressed)
    except KeyboardInterrupt:
        interruption.answer()
        print("raised", interruption.pressed)
    with interruption.deferring():
        press()
        interruption.answer()
    time.sleep(0.3)
    print("answered")
"""
    assert outcome(code) == (0, "True\nraised False\nanswered\n", "")


def test_handling_within_handling_changes_nothing() -> None:
    code = """
with interruption.handling(), interruption.deferring():
    press()
    with interruption.handling():
        print(interruption.pressed)
    interruption.answer()
print(interruption.pressed)
"""
    assert outcome(code) == (0, "True\nFalse\n", "")


def test_handlers_are_as_before_afterwards() -> None:
    handler = signal.getsignal(signal.SIGINT)
    with ctrl_c_here():
        with Interruption().handling():
            assert signal.getsignal(signal.SIGINT) is not signal.default_int_handler
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.getsignal(signal.SIGINT) is handler
    assert signal.set_wakeup_fd(-1) == -1


def test_ctrl_c_that_is_ignored_stays_ignored() -> None:
    code = """
signal.signal(signal.SIGINT, signal.SIG_IGN)
with interruption.handling():
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    press()
    assert not interruption.pressed
assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
"""
    assert outcome(code) == (0, "", "")
