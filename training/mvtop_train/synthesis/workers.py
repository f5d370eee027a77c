"""Work that several processes share, each with its own GL context."""

import multiprocessing
import signal
import time

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

    What one of them raises is raised at once, and the others are ended. Processes are spawned: a GL
    context does not survive a fork.
    """
    context = multiprocessing.get_context("spawn")
    workers = max(1, min(workers, len(tasks)))
    # The manager outlives the pool, whose workers write to its queue.
    with context.Manager() as manager, context.Pool(workers, _ignore_interrupt) as pool, bar:
        queue = manager.Queue()
        jobs = [job_of(list(tasks[i::workers]), queue) for i in range(workers)]
        begun = _children()
        failed = []
        results = [pool.apply_async(work, (job,), error_callback=failed.append) for job in jobs]

        def at_work() -> bool:
            return not all(result.ready() for result in results)

        while not failed and (at_work() or not queue.empty()):
            time.sleep(0.1)
            # A pool puts another one in the place of a process that has crashed, and waits for its
            # job for ever.
            if not begun <= _children() and at_work():
                raise UserError(
                    f"{bar.desc or 'work'}: expected {workers} processes to the end, got one that "
                    "crashed (too little memory, or the graphics driver?); fix: fewer "
                    "workers where memory is short, then the same command, which goes on where "
                    "this one was"
                )
            while not queue.empty():
                queue.get()
                bar.update()
        if failed:
            raise failed[0]
