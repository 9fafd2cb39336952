"""Robots: kinematics against MuJoCo's, tables that compile, an arm from anybody's file."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest

from rcbht_jax.errors import InputError
from sim_mjx.assemblies import ASSEMBLIES
from sim_mjx.assemblies.scene import home
from sim_mjx.registry import pair
from sim_mjx.robots import ROBOTS, Robot, from_mjcf
from sim_mjx.robots.chain import about, jacobian, pose, rotation_vector, serial_chain
from sim_mjx.robots.robot import FORCE, HAND, equipped

# An arm whose axes, anchors and frames are in no way special, with two hinges in one body and a gripper that hangs on.
ARM = """<mujoco><worldbody><body pos="0.1 0.2 0.3" euler="10 20 30">
  <joint name="a" axis="1 2 3" pos="0.01 0.02 0.03" ref="20"/><geom size="0.05"/>
  <body pos="0 0.1 0.2" euler="-40 5 60"><joint name="b" axis="0 1 1" pos="0.02 0 0"/>
    <joint name="c" axis="1 0 -1" pos="0 0.03 0.01"/><geom size="0.05"/>
    <body pos="0.1 0 0.2"><joint name="d" axis="0 1 0"/><geom size="0.04"/>
      <site name="wrist" pos="0 0 0.1" euler="7 8 9"/>
      <body pos="0 0 0.1"><joint name="finger" type="slide"/><geom size="0.01"/></body>
    </body></body></body></worldbody>
  <actuator><motor joint="a"/></actuator></mujoco>"""


def check_chain(model: mujoco.MjModel, site: str, joints: tuple[str, ...]) -> None:
    chain, data, number = serial_chain(model, site), mujoco.MjData(model), model.site(site).id
    rows, dofs = ([getattr(model.joint(name), key)[0] for name in joints] for key in ("qposadr", "dofadr"))
    batch = np.random.default_rng(0).uniform(-2.0, 2.0, (5, len(joints))).astype(np.float32)
    places, turns = jax.jit(jax.vmap(pose, (None, 0)))(chain, batch)
    matrices = jax.jit(jax.vmap(jacobian, (None, 0)))(chain, batch)
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for angles, place, turn, matrix in zip(batch, places, turns, matrices, strict=True):
        data.qpos[rows] = angles
        mujoco.mj_forward(model, data)
        mujoco.mj_jacSite(model, data, linear, angular, number)
        np.testing.assert_allclose(place, data.site_xpos[number], atol=2e-6)
        np.testing.assert_allclose(turn, data.site_xmat[number].reshape(3, 3), atol=2e-6)
        np.testing.assert_allclose(matrix, np.concatenate([linear, angular])[:, dofs], atol=2e-6)


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=list(ROBOTS))
def test_pose_and_jacobian_are_mujocos(robot: Robot) -> None:
    model = equipped(robot).compile()
    check_chain(model, HAND, robot.joints)
    assert model.nu == model.nv == len(robot.joints)
    assert (np.linalg.eigvalsh([np.diag(inertia) for inertia in model.body_inertia[1:]]) >= 0).all()
    # the hand's weight is all that the wrist's sensor feels at home
    data = mujoco.MjData(model)
    data.qpos[:] = data.ctrl[:] = robot.home
    mujoco.mj_step(model, data, 400)
    force = data.sensordata[model.sensor(FORCE).adr[0] :][:3]
    assert np.linalg.norm(force) == pytest.approx(9.81 * robot.tool_mass, rel=1e-3)
    np.testing.assert_allclose(data.qpos, robot.home, atol=1e-4)


def test_the_arms_are_as_long_as_published() -> None:
    """Distances from the base at zero angles, from the makers' drawings: reach and height of the flange."""
    for name, height, out in (("panda", 0.333 + 0.316 + 0.384 - 0.107, 0.088), ("ur5e", 0.1625 - 0.0997, 0.8172)):
        model = equipped(ROBOTS[name]).compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        place = data.site(HAND).xpos
        assert (place[2], abs(place[0])) == (pytest.approx(height, abs=1e-6), pytest.approx(out, abs=1e-6))


def test_a_rotation_is_its_vector() -> None:
    vector = np.array([0.3, -0.8, 0.5], np.float32)
    angle = np.float32(np.linalg.norm(vector))
    np.testing.assert_allclose(rotation_vector(about(vector / angle, angle)), vector, rtol=1e-5)
    assert not np.isnan(rotation_vector(np.eye(3, dtype=np.float32))).any()


def check_hand(model: mujoco.MjModel) -> None:
    """The hand has the wrist's frame, in whatever way a file gives it."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.body(HAND).xpos, data.site("arm/wrist").xpos, atol=1e-12)
    np.testing.assert_allclose(data.body(HAND).xmat, data.site("arm/wrist").xmat, atol=1e-12)


def test_anybodys_arm(tmp_path: Path) -> None:
    path = tmp_path / "mine.xml"
    path.write_text(ARM)
    robot = from_mjcf(path, site="wrist", home=(0.0, 0.1, 0.2, 0.3), place=(0.5, 0.0, 0.1))
    assert (robot.name, robot.joints) == ("mine", ("arm/a", "arm/b", "arm/c", "arm/d"))
    model = equipped(robot).compile()
    check_chain(model, HAND, robot.joints)
    check_hand(model)
    assert (model.nu, model.nsensor) == (4, 2)
    framed = ARM.replace("<site", '<frame pos="0.02 0 0.01" axisangle="0 1 0 40"><site').replace(
        '7 8 9"/>', '7 8 9"/></frame>'
    )
    path.write_text(framed)
    check_hand(equipped(from_mjcf(path, site="wrist", home=(0.0, 0.1, 0.2, 0.3), place=(0.5, 0.0, 0.1))).compile())
    with pytest.raises(InputError, match="home has 2 angles; expected one per joint of the arm, 4"):
        from_mjcf(path, site="wrist", home=(0.0, 0.1), place=(0.5, 0.0, 0.1))
    with pytest.raises(InputError, match="no site 'hand'"):
        from_mjcf(path, site="hand", home=(0.0, 0.1), place=(0.5, 0.0, 0.1))
    with pytest.raises(InputError, match="There is no file"):
        from_mjcf(tmp_path / "other.xml", site="hand", home=(), place=(0.5, 0.0, 0.1))
    path.write_text("<mujoco><worldbody>")
    with pytest.raises(InputError, match=r"cannot be read as MJCF: .* Line number=1"):
        from_mjcf(path, site="hand", home=(), place=(0.5, 0.0, 0.1))
    path.write_text(ARM.replace("<worldbody>", '<compiler settotalmass="50"/><worldbody>'))
    with pytest.raises(InputError, match="sets the arm's mass by settotalmass"):
        from_mjcf(path, site="wrist", home=(0.0, 0.1, 0.2, 0.3), place=(0.5, 0.0, 0.1))
    for kind in ("slide", "ball", "free"):  # before the arm is moved
        path.write_text(ARM.replace('name="a"', f'name="a" type="{kind}"'))
        with pytest.raises(InputError, match="The joint 'arm/a' is no hinge"):
            from_mjcf(path, site="wrist", home=(0.0, 0.1, 0.2, 0.3), place=(0.5, 0.0, 0.1))
    cart = '<body name="cart"><freejoint/><geom size="0.1"/><body pos'
    path.write_text(ARM.replace("<body pos", cart, 1).replace("</worldbody>", "</body></worldbody>"))
    with pytest.raises(InputError, match="The joint without a name of the body 'arm/cart' is no hinge"):
        from_mjcf(path, site="wrist", home=(0.0, 0.1, 0.2, 0.3), place=(0.5, 0.0, 0.1))
    path.write_text(ARM.replace('<body pos="0.1 0.2 0.3"', '<site name="base"/><body pos="0.1 0.2 0.3"'))
    with pytest.raises(InputError, match="No joint of the robot mine moves its site 'arm/base'"):
        from_mjcf(path, site="base", home=(), place=(0.5, 0.0, 0.1))
    meshed = ARM.replace("<worldbody>", '<asset><mesh name="link" file="link.stl"/></asset><worldbody>')
    path.write_text(meshed.replace('<geom size="0.05"/>', '<geom type="mesh" mesh="link"/>', 1))
    robot = from_mjcf(path, site="wrist", home=(0.0, 0.1, 0.2, 0.3), place=(0.5, 0.0, 0.1))
    with pytest.raises(InputError, match=r"cannot compile clip on mine: Error opening file 'link.stl'"):
        pair(ASSEMBLIES["clip"], robot).scene()
    sliding = mujoco.MjModel.from_xml_string(ARM.replace('name="d"', 'name="d" type="slide"'))
    with pytest.raises(InputError, match="'d' is no hinge"):
        serial_chain(sliding, "wrist")


TENDONS = """<tendon><fixed name="arm's" stiffness="50" frictionloss="1"><joint joint="b" coef="1"/></fixed>
  <fixed name="finger's" stiffness="50" springlength="1" frictionloss="1"><joint joint="finger" coef="1"/></fixed>
  <spatial stiffness="50" springlength="0.1"><site site="base"/><site site="wrist"/></spatial></tendon></mujoco>"""


@pytest.mark.parametrize("spring", ['stiffness="50"', 'springdamper="0.1 1"', 'frictionloss="1"', ""])
def test_springs_and_friction_of_an_arm_do_not_bend_its_servos(spring: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.xml"
    arm = ARM.replace("<joint", f"<joint {spring}").replace("<worldbody>", '<worldbody><site name="base"/>')
    path.write_text(arm if spring else arm.replace("</mujoco>", TENDONS))
    robot = from_mjcf(path, site="wrist", home=(0.0, 0.1, 0.2, 0.3), place=(0.5, 0.0, 0.1))
    model = equipped(robot).compile()
    data = mujoco.MjData(model)
    data.qpos[:] += 1.0
    data.qvel[:] = 1.0
    mujoco.mj_forward(model, data)
    bent = [model.joint(model.dof_jntid[dof]).name for dof in np.flatnonzero(data.qfrc_spring + data.qfrc_constraint)]
    assert bent == ["arm/finger"]  # which no servo moves


def test_limits_of_a_files_motors_do_not_weaken_the_servos(tmp_path: Path) -> None:
    path = tmp_path / "mine.xml"
    path.write_text(ARM.replace("<joint", '<joint actuatorfrcrange="-1 1"'))
    model = equipped(from_mjcf(path, site="wrist", home=(0.0, 0.1, 0.2, 0.3), place=(0.5, 0.0, 0.1))).compile()
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.0
    mujoco.mj_forward(model, data)
    assert abs(data.actuator_force).min() > 1.0
    np.testing.assert_array_equal(data.qfrc_actuator[:4], data.actuator_force)


@pytest.mark.parametrize(
    "end",
    [
        '<equality><joint joint1="JOINT3" polycoef="0.3 0 0 0 0"/></equality>',
        '<tendon><fixed range="-0.1 0.1" limited="true"><joint joint="JOINT2" coef="1"/></fixed></tendon>',
    ],
)
def test_an_arm_that_cannot_stay_at_its_start_is_refused(end: str, tmp_path: Path) -> None:
    (tmp_path / "mine.xml").write_text(ROBOTS["panda"].build().to_xml().replace("</mujoco>", f"{end}</mujoco>"))
    panda = ROBOTS["panda"]
    robot = from_mjcf(tmp_path / "mine.xml", site="WRIST", home=panda.home, place=panda.place)
    with pytest.raises(
        InputError, match=r"mine does not stay at the start of clip: the model moves the wrist by \S+ mm"
    ):
        home(ASSEMBLIES["clip"], robot)


def test_an_arm_is_held_at_its_start_with_the_time_step_of_its_trials() -> None:
    clip = ASSEMBLIES["clip"]

    def female(spec: mujoco.MjSpec, mount: mujoco.MjsBody) -> None:
        clip.female(spec, mount)
        pin = mount.add_body(name="pin", mass=0.01, inertia=(1e-6, 1e-6, 1e-6), explicitinertial=True)
        pin.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, stiffness=[1e5, 0.0, 0.0], springref=1e-3)  # 3160 rad/s

    assert home(replace(clip, female=female, substeps=20), ROBOTS["panda"]) == home(clip, ROBOTS["panda"])


def test_a_files_muscles_and_view_do_not_matter(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.xml"
    muscle = '<tendon><fixed name="t"><joint joint="a" coef="0"/></fixed></tendon><actuator><muscle tendon="t"/>'
    view = '<visual><map znear="0.5"/></visual><statistic extent="50"/><worldbody>'
    path.write_text(ARM.replace("<actuator>", muscle).replace("<worldbody>", view))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        equipped(from_mjcf(path, site="wrist", home=(0.0, 0.1, 0.2, 0.3), place=(0.5, 0.0, 0.1))).compile()
    assert capfd.readouterr() == ("", "")


def test_a_robot_may_be_built_once() -> None:
    spec = ROBOTS["panda"].build()
    once, panda = replace(ROBOTS["panda"], build=lambda: spec), ROBOTS["panda"]
    for _ in range(2):
        first, second = (pair(ASSEMBLIES["clip"], robot).scene().model for robot in (once, panda))
        np.testing.assert_array_equal(first.body_mass, second.body_mass)
    assert (len(spec.actuators), len(spec.sensors), spec.body(HAND)) == (0, 0, None)


def test_what_a_file_says_of_its_arm_holds_for_the_arm_and_for_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "mine.xml"
    limited = ARM.replace("<body pos", '<body childclass="own" pos', 1).replace('ref="20"', 'ref="20" range="-166 166"')
    settings = '<option gravity="0 0 1"><flag contact="disable"/></option><default><joint armature="0.5" damping="2"/>'
    settings = '<size nuserdata="4" nkey="2" nuser_body="1" nuser_jnt="1" nuser_geom="2" nconmax="9"/>' + settings
    settings += '<pair margin="1"/><default class="own"><joint frictionloss="3"/></default></default>'
    path.write_text(limited.replace("<worldbody>", f"{settings}<worldbody>"))
    alone, spec = (
        mujoco.MjModel.from_xml_path(str(path)),
        equipped(from_mjcf(path, site="wrist", home=(0.0, 0.1, 0.2, 0.3), place=(0.5, 0.0, 0.1))),
    )
    hand, mount = spec.body(HAND), spec.worldbody.add_body(name="MOUNT", mass=1.0, inertia=(1.0, 1.0, 1.0))
    hand.add_joint(name="own hinge", range=(-1.0, 1.0))
    mount.add_joint(name="own slide", type=mujoco.mjtJoint.mjJNT_SLIDE)
    model = spec.compile()
    assert (model.opt.gravity[2], model.opt.disableflags, spec.default.pair.margin) == (-9.81, 0, 0.0)
    for name in ("a", "b", "c", "d", "finger"):  # an angle is in degrees unless a file says otherwise
        first, second = alone.joint(name), model.joint(f"arm/{name}")
        for key in ("range", "qpos0", "armature", "damping", *(("frictionloss",) if name == "finger" else ())):
            np.testing.assert_array_equal(getattr(first, key), getattr(second, key), err_msg=key)
    np.testing.assert_allclose(model.site("arm/wrist").quat, alone.site("wrist").quat)
    np.testing.assert_allclose(model.body_quat[1], alone.body_quat[1])
    np.testing.assert_array_equal(model.joint("own hinge").range, [-1.0, 1.0])
    for name in ("own hinge", "own slide"):
        row = model.joint(name)
        assert (row.armature, row.damping, row.frictionloss) == ([0.0], [0.0], [0.0])
