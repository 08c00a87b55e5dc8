"""A quadruped of spheres as an MJCF file."""

LEG = """
<body name="{leg}_hip" pos="{x} {y} 0"><joint name="{leg}_hip_joint" axis="1 0 0"/><geom size="0.03" mass="0.5"/>
  <body name="{leg}_thigh" pos="0 {d} 0"><joint name="{leg}_thigh_joint" axis="0 1 0"/><geom size="0.03" mass="0.5"/>
    <body name="{leg}_calf" pos="0 0 -0.2"><joint name="{leg}_calf_joint" axis="0 1 0" range="-2.7 -0.8"/>
      <geom size="0.02" pos="0 0 -0.2" mass="0.1"/></body></body></body>
"""


def tiny(*changes: tuple[str, str]) -> str:
    """A quadruped of spheres, with something changed; a joint that is gone takes its motor along."""
    places = {"FR": (0.2, -0.05, -0.08), "FL": (0.2, 0.05, 0.08), "RR": (-0.2, -0.05, -0.08), "RL": (-0.2, 0.05, 0.08)}
    legs = "".join(LEG.format(leg=leg, x=x, y=y, d=d) for leg, (x, y, d) in places.items())
    names = [f"{leg}_{joint}_joint" for leg in places for joint in ("hip", "thigh", "calf")]
    motors = "".join(f'<motor joint="{name}" ctrlrange="-20 20"/>' for name in names)
    text = (
        '<mujoco><compiler angle="radian"/><worldbody><body name="base" pos="0 0 1"><freejoint/>'
        f'<geom type="box" size="0.2 0.1 0.05" mass="5"/>{legs}</body></worldbody>'
        f"<actuator>{motors}</actuator></mujoco>"
    )
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    for name in names:
        if f'<joint name="{name}"' not in text:
            text = text.replace(f'<motor joint="{name}" ctrlrange="-20 20"/>', "")
    return text
