"""Work that several processes share, each with its own GL context."""

import multiprocessing
import signal

from tqdm import tqdm

from ..errors import UserError


def while_asked_for(tasks):
    """The tasks, until the process that gave them has been killed."""
    parent = multiprocessing.parent_process()
    for task in tasks:
        if parent is not None and not parent.is_alive():
            return
        yield task


def _ignore_interrupt():
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent stops its workers


def _children() -> set[int | None]:
    return {child.pid for child in multiprocessing.active_children()}


def run_workers(work, tasks, workers: int, job_of, bar: tqdm):
    """Run `work(job_of(part of tasks, queue))` in processes; each puts a number per task done.

    Processes are spawned: a GL context does not survive a fork.
    """
    context = multiprocessing.get_context("spawn")
    workers = max(1, min(workers, len(tasks)))
    # The manager outlives the pool, whose workers write to its queue.
    with context.Manager() as manager, context.Pool(workers, _ignore_interrupt) as pool, bar:
        queue = manager.Queue()
        jobs = [job_of(list(tasks[i::workers]), queue) for i in range(workers)]
        begun = _children()
        result = pool.map_async(work, jobs, chunksize=1)
        while not result.ready() or not queue.empty():
            result.wait(0.2)
            # A pool puts another one in the place of a process that has crashed, and waits for its
            # job for ever.
            if not begun <= _children() and not result.ready():
                raise UserError(
                    f"{bar.desc or 'work'}: expected {workers} processes to the end, got one that "
                    "crashed (the graphics driver?); fix: the same command again, which goes on "
                    "where this one was"
                )
            while not queue.empty():
                queue.get()
                bar.update()
        result.get()  # raises what a worker raised
