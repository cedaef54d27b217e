"""Linear algebra on one thread: as long as anyone needs it, and no longer."""

import threading
from collections.abc import Iterator

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from sdpid._common.threads import one_thread
from tests.helpers.refusals import refuses


@pytest.fixture(autouse=True)
def libraries() -> Iterator[None]:
    """Load all libraries of linear algebra, and let each use three threads."""
    one_thread(int)()
    with threadpool_limits(3, user_api="blas"):
        yield


def blas_threads() -> set[int]:
    """Return the numbers of threads of the linear algebra libraries that have threads.

    SCS, which other tests load, brings one that was built without.
    """
    found = (each for each in threadpool_info() if each["user_api"] == "blas")
    return {each["num_threads"] for each in found if each["threading_layer"] != "disabled"}


def test_one_thread_while_it_runs_and_as_many_as_before_after_it() -> None:
    assert one_thread(blas_threads)() == {1}
    assert one_thread(one_thread(blas_threads))() == {1}
    assert blas_threads() == {3}


def test_overlapping_calls_leave_the_number_of_threads_as_it_was() -> None:
    """The one that began first ends first: the other still has one thread, and puts it back."""
    first_runs, second_runs, first_ended = (threading.Event() for _ in range(3))
    seen: list[set[int]] = []

    @one_thread
    def first() -> None:
        first_runs.set()
        assert second_runs.wait(10.0)

    @one_thread
    def second() -> None:
        second_runs.set()
        assert first_ended.wait(10.0)
        seen.append(blas_threads())

    one, two = threading.Thread(target=first), threading.Thread(target=second)
    one.start()
    # The second begins while the first runs.
    assert first_runs.wait(10.0)
    two.start()
    one.join()
    first_ended.set()
    two.join()
    assert seen == [{1}]
    assert blas_threads() == {3}


def test_an_error_puts_the_number_of_threads_back() -> None:
    @one_thread
    def fail() -> None:
        raise ValueError("failed")

    refuses(ValueError, "failed", fail)
    assert blas_threads() == {3}
