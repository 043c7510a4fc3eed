"""A sweep in a process of its own, to be killed."""

import subprocess
import sys
import time

import cheap

from softcal_jax.sweeps import read_sweep


def started(path, where):
    """The sweep of `cheap`, once its first rows are on the disk."""
    driver = subprocess.Popen([sys.executable, cheap.__file__, str(path), where])
    wait_for(driver, path, 3)
    return driver


def wait_for(driver, path, rows):
    """Wait until a sweep has so many rows on the disk."""
    while driver.poll() is None:
        if rows_on_disk(path) >= rows:
            return
        time.sleep(0.02)
    raise AssertionError(f"the sweep ended before it had {rows} rows")


def rows_on_disk(path):
    """Number of trials of a sweep that are safe by now."""
    return len(read_sweep(path).rows) if [*path.glob("*.parquet")] else 0


def kill(driver):
    """kill -9, which leaves nobody time for anything."""
    driver.kill()
    driver.wait()
