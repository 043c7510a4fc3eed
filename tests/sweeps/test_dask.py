"""A sweep on a Dask cluster of two local workers."""

import os
import signal

import cheap
import pytest
from killable import kill, started, wait_for
from rows import ends, substance

from softcal_jax.sweeps import grid, read_sweep, run_sweep


@pytest.fixture
def cluster():
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50
    ) as made:
        yield made


def processes(address):
    """Process of each worker of a cluster."""
    from distributed import Client

    with Client(address, set_as_default=False) as client:
        return list(client.run(os.getpid).values())


@pytest.mark.slow
def test_kill_a_worker_and_the_driver_of_a_cluster(cluster, tmp_path):
    """Row by row what one process gives without any of it."""
    expected = run_sweep(
        cheap.measure, cheap.POINTS, tmp_path / "here", repeats=["draw"],
        workers=0,
    )  # fmt: skip
    path, address = tmp_path / "s", cluster.scheduler_address
    driver = started(path, address)
    before = processes(address)
    os.kill(before[0], signal.SIGKILL)
    wait_for(driver, path, 8)
    kill(driver)
    left = read_sweep(path)
    assert 8 <= len(left.rows) < 24

    result = run_sweep(
        cheap.slowly, cheap.POINTS, path, repeats=["draw"], executor=address
    )
    assert substance(result) == substance(expected)
    assert ends(left).items() <= ends(result).items()
    # The cluster did the work, and a new process took the place of the killed one.
    now = processes(address)
    assert before[0] not in now
    ran = {int(row["worker"].split()[1]) for row in result.rows}
    assert ran & set(now)
    assert os.getpid() not in ran

    # Workers of a cluster compute as this process does, too.
    points = grid({"a": [1, 2, 3]})
    result = run_sweep(cheap.where, points, tmp_path / "t", executor=address)
    assert set(result.numbers("float64")) == {1.0}
    assert set(result.numbers("cores")) == {1.0}


@pytest.mark.slow  # until the client gives up
def test_no_scheduler_there(tmp_path):
    address = "tcp://127.0.0.1:1"
    with pytest.raises(OSError, match=f'no Dask scheduler .*"{address}"'):
        run_sweep(cheap.measure, cheap.POINTS, tmp_path / "s", executor=address)
