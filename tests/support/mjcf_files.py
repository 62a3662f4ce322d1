"""Robots as MJCF text: an arm of two joints whose parts can be replaced, and a quadruped with a keyframe."""

ARM = """<mujoco model="arm"><compiler angle="radian" {compiler}/>{options}<worldbody>{scene}
<body name="a" pos="0.1 0 0.2" euler="0.2 0.1 0.3">{first}
<geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.03"/>
<body name="b" pos="0 0.05 0.3">{second}<geom type="box" size="0.03 0.05 0.1" pos="0 0 0.1"/>{more}
<site name="tip" pos="0 0 0.3"/></body></body></worldbody>{after}</mujoco>"""
HINGES = {"first": '<joint name="ja" axis="0 1 0"/>', "second": '<joint name="jb" axis="1 0 0"/>'}
BLANK = dict.fromkeys(("compiler", "options", "scene", "more", "after"), "")


def arm(**parts: str) -> str:
    """An arm on the world; its hinges are ``ja`` about y and ``jb`` about x."""
    return ARM.format(**(BLANK | HINGES | parts))


LEG = """<body name="{leg}_hip" pos="{x} {y} 0"><joint name="{leg}_hip" class="hip"/>
<geom fromto="0 0 0 0 {y} 0" mass="0.3"/><body name="{leg}_thigh" pos="0 {y} 0"><joint name="{leg}_thigh"/>
<geom fromto="0 0 0 0 0 -0.2"/><body name="{leg}_calf" pos="0 0 -0.2">
<joint name="{leg}_calf" range="-150 -20"/><geom fromto="0 0 0 0 0 -0.2"/>
<geom name="{leg}_foot" type="sphere" size="0.02" pos="0 0 -0.2"/><site name="{leg}_site" pos="0 0 -0.2"/>
</body></body></body>"""
LEGS = {"FL": (0.18, 0.1), "FR": (0.18, -0.1), "RL": (-0.18, 0.1), "RR": (-0.18, -0.1)}
FEET = tuple(f"{leg}_foot" for leg in LEGS)
MOTORS = "".join(
    f'<motor joint="{leg}_{joint}" ctrlrange="-1 1" gear="{gear}"/>'
    for leg in LEGS
    for joint, gear in (("hip", 20), ("thigh", 20), ("calf", 30))
)
QUADRUPED = f"""<mujoco model="mini"><compiler autolimits="true"/><default>
<joint axis="0 1 0" range="-120 120" armature="0.01" damping="0.1"/>
<geom type="capsule" size="0.015" density="900"/>
<default class="hip"><joint axis="1 0 0" range="-45 45"/></default></default><worldbody>
<body name="trunk" pos="0 0 0.45"><freejoint name="root"/><geom type="box" size="0.2 0.1 0.05" mass="6"/>
{"".join(LEG.format(leg=leg, x=x, y=y) for leg, (x, y) in LEGS.items())}</body></worldbody>
<actuator>{MOTORS}</actuator>
<keyframe><key name="home" qpos="0 0 0.28 1 0 0 0{4 * " 0 0.8 -1.6"}"/></keyframe></mujoco>"""
SCENE = """<mujoco model="scene"><include file="quad.xml"/>
<worldbody><geom type="plane" size="5 5 0.1"/></worldbody></mujoco>"""
