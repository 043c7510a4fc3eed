"""A sweep in a process of its own, to be killed."""

import subprocess
import sys

import cheap


def started(path, where):
    """The sweep of `cheap`, once its first rows are there."""
    driver = subprocess.Popen(
        [sys.executable, cheap.__file__, str(path), where],
        stdout=subprocess.PIPE,
        text=True,
    )
    wait_for(driver, 3)
    return driver


def wait_for(driver, rows):
    """Wait until a sweep has so many rows."""
    assert driver.stdout is not None
    for line in driver.stdout:
        if int(line) >= rows:
            return
    raise AssertionError(f"the sweep ended before it had {rows} rows")


def kill(driver):
    """kill -9, which leaves nobody time for anything."""
    driver.kill()
    driver.wait()
    driver.stdout.close()
