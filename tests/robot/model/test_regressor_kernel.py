"""The compiled regressor against Pinocchio's, and what happens without Numba."""

import builtins
import logging
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given

from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError, SdpidError
from sdpid.robot.description.catalog import example_robots
from sdpid.robot.model import regressor_kernel as kernels
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC, TREE_MIMIC_NO_OFFSET, pendulum
from tests.helpers.small_robots import URDFS
from tests.helpers.strategies import SEEDS, dh_tables
from tests.helpers.tolerances import DYNAMICS

pytest.importorskip("numba")

# A sample of every kind: arms, hands, legs, humanoids, wheels.
SAMPLE = ("allegro_left_hand", "iris", "panda", "solo12", "talos_reduced", "tiago", "ur5_robot")


@pytest.fixture(scope="module", autouse=True)
def _however_few() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kernels, "SMALL", 0)
        yield


def states(robot: RobotModel, rng: np.random.Generator, count: int) -> tuple[Array, Array, Array]:
    """Return states for Pinocchio's own coordinates."""
    model = robot.pin_model
    v, a = rng.normal(size=(2, count, robot.n)) @ robot.expansion.T
    q = rng.uniform(-3.0, 3.0, (count, robot.n)) @ robot.expansion.T + robot.offset
    return np.stack([pin.integrate(model, pin.neutral(model), x) for x in q]), v, a


def check(robot: RobotModel, seed: int, count: int = 3) -> None:
    q, v, a = states(robot, np.random.default_rng(seed), count)
    found, expected = kernels.regressor(robot.tree, q, v, a), robot._pinocchio_regressor(q, v, a)
    assert found is not None
    scale = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(found, expected, rtol=0, atol=DYNAMICS * scale)


@given(dh_tables(), SEEDS)
def test_serial_arms(table: Any, seed: int) -> None:
    check(RobotModel.from_mdh(table), seed)


@pytest.mark.parametrize("root", [None, "free_flyer"])
@pytest.mark.parametrize("text", [TREE, TREE_MIMIC, TREE_MIMIC_NO_OFFSET, *URDFS])
@given(seed=SEEDS)
def test_trees(text: str, root: Any, seed: int) -> None:
    if not (text is TREE_MIMIC and root):  # an offset does not go with a floating base
        check(load_robot(text, root=root, gravity=(1.0, -2.0, 3.0)), seed)


@pytest.mark.parametrize("name", SAMPLE)
def test_robots_of_example_robot_data(name: str) -> None:
    check(load_robot(name, root="free_flyer"), 1)


@pytest.mark.examples
@pytest.mark.parametrize("name", example_robots())
def test_every_robot_of_example_robot_data(name: str) -> None:
    for root in (None, "free_flyer"):
        try:
            robot = load_robot(name, root=root)
        except SdpidError:
            continue
        check(robot, 2)


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("text", [TREE, TREE_MIMIC, *URDFS])
def test_small_new_and_used_memory_are_filled_the_same(
    text: str, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As zeros from the system, and cleared sample by sample, in several threads."""
    robot = load_robot(text)
    arrays, tree = states(robot, np.random.default_rng(3), 50), robot.tree
    cleared = kernels.regressor(tree, *arrays)
    monkeypatch.setattr(kernels, "_LARGE", 0)
    monkeypatch.setattr(kernels, "threads", lambda: threads)
    np.testing.assert_array_equal(kernels.regressor(tree, *arrays), cleared)
    memory = np.full(cleared.shape, np.nan)
    assert kernels.regressor(tree, *arrays, out=memory) is memory
    np.testing.assert_array_equal(memory, cleared)


@pytest.mark.parametrize("numba", [True, False])
def test_some_columns_in_a_wider_block(numba: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not numba:
        monkeypatch.setattr(kernels, "compiled", lambda: None)
    for robot in (load_robot(TREE), load_robot(TREE_MIMIC)):
        rng = np.random.default_rng(4)
        q, v, a = rng.uniform(-1.0, 1.0, (3, 20, robot.n))
        whole = robot.regressor(q, v, a)
        places = np.full(10 * robot.n_links, -1)
        wanted = np.sort(rng.choice(len(places), len(places) // 2, replace=False))
        places[wanted] = rng.permutation(len(wanted) + 3)[: len(wanted)]
        out = np.full((20, robot.n, len(wanted) + 3), np.nan)
        assert robot.regressor_columns(q, v, a, places=places, out=out) is out
        np.testing.assert_allclose(out[:, :, places[wanted]], whole[:, :, wanted], atol=1e-13)
        others = np.setdiff1d(np.arange(out.shape[2]), places[wanted])
        assert not out[:, :, others].any()


def test_memory_of_the_wrong_shape_is_refused(denso: RobotModel) -> None:
    q = np.zeros((4, 6))
    narrow, single = np.zeros((4, 6, 59)), np.zeros((4, 6, 60), dtype=np.float32)
    for wrong in (narrow, single, np.zeros((60, 6, 4)).T):
        refuses(DataError, "out: shape", denso.regressor, q, q, q, out=wrong)
    out = np.zeros((4, 6, 60))
    assert denso.regressor(q, q, q, out=out) is out
    places, words = np.arange(1, 61), "places: 60 entries up to 60"
    refuses(DataError, words, denso.regressor_columns, q, q, q, places=places, out=out)


def test_neighbors_and_memory_of_the_states_do_not_matter(denso: RobotModel) -> None:
    q, v, a = states(denso, np.random.default_rng(5), 20)
    whole = denso.regressor(q, v, a)
    for rows in (slice(7, 9), slice(None, None, 3)):
        np.testing.assert_array_equal(denso.regressor(q[rows], v[rows], a[rows]), whole[rows])
    np.testing.assert_array_equal(denso.regressor(*map(np.asfortranarray, (q, v, a))), whole)
    for x in (q, v, a):
        x.setflags(write=False)
    np.testing.assert_array_equal(denso.regressor(q, v, a), whole)
    assert len(kernels.compiled().signatures) == 1


def test_uncompiled_the_loop_gives_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels, "compiled", lambda: kernels._fill)
    check(load_robot(TREE_MIMIC_NO_OFFSET, root="free_flyer"), 6)
    check(load_robot(TREE_MIMIC), 6)


@pytest.fixture
def forgotten() -> Iterator[None]:
    """Let the loop be loaded again, and once more afterwards."""
    kernels.compiled.cache_clear()
    yield
    kernels.compiled.cache_clear()


@pytest.mark.usefixtures("forgotten")
def test_without_numba_it_is_pinocchio(denso: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    q, v, a = states(denso, np.random.default_rng(7), 5)
    real = builtins.__import__

    def refuse(name: str, *rest: Any, **more: Any) -> Any:
        if name == "numba":
            raise ImportError("Numba needs NumPy 1.0 or less")
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", refuse)
    assert kernels.compiled() is None
    np.testing.assert_array_equal(denso.regressor(q, v, a), denso._pinocchio_regressor(q, v, a))


@pytest.mark.usefixtures("forgotten")
@pytest.mark.parametrize("error", [RuntimeError("no locator"), OSError("disk full")])
def test_without_a_folder_for_the_cache_it_is_compiled_again(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    import numba

    asked = []

    def njit(cache: bool = False, **options: Any) -> Any:
        asked.append(cache)
        if cache:
            raise error
        return lambda function: function  # compiled or not is all the same here

    monkeypatch.setattr(numba, "njit", njit)
    assert kernels.compiled() is kernels._fill
    assert asked == [True, False]
    check(pendulum(), 8)


def test_joints_that_screw_and_gravity_that_turns_are_refused() -> None:
    model = pin.Model()
    model.addJoint(0, pin.JointModelHelicalUnaligned(np.eye(3)[0], 0.1), pin.SE3.Identity(), "x")
    refuses(ModelError, "'x' is a JointModelHelical", RobotModel.from_pinocchio, model)
    turning = pin.buildSampleModelHumanoid()
    RobotModel.from_pinocchio(turning)
    turning.gravity.angular = np.ones(3)
    refuses(ModelError, "angular", RobotModel.from_pinocchio, turning)


def test_long_compilation_is_announced(
    caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    with caplog.at_level(logging.INFO, "sdpid"):
        kernels._say("a loop")
    assert "once" in caplog.text
    assert capsys.readouterr().err == ""  # no terminal


def test_the_compilation_is_kept(tmp_path: Path) -> None:
    code = (
        "import numpy as np, sdpid; r = sdpid.load_robot('denso_vp6242'); x = np.ones((6000, 6));"
        "assert np.isfinite(r.regressor(x, x, x)).all()"
    )
    where = {"NUMBA_CACHE_DIR": str(tmp_path), "PATH": "", "HOME": str(tmp_path)}
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300, env=where)
    assert list(tmp_path.rglob("*.nbi"))


def test_few_samples_do_not_load_numba() -> None:
    code = (
        "import sys, numpy as np, sdpid; r = sdpid.load_robot('denso_vp6242');"
        "x = np.ones((300, 6)); r.regressor(x, x, x); assert 'numba' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300)
