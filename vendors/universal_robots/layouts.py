"""The frame of the real-time interface of Universal Robots, as pushed on port 30013.

    0              4        12         60                                     1220
    +--------------+--------+----------+----------------------------------------+
    | size, 4 bytes| time   | q target | ... 152 values in all, each one f64     |
    +--------------+--------+----------+----------------------------------------+
      size = all bytes of the frame, these four included; everything is big-endian

Source: Universal Robots, Realtime Client Interface, tables RealTime 5.9 and RealTime 5.10; the same pages stand in the
manual of PolyScope 5.25, "Client interfaces". Sizes and contents of older frames: the clients ur_modern_driver (ROS
Industrial: 3.0, 3.2, 3.5 and 5.1, 3.10 and 5.4) and Robotics Library, which read them. A newer table only adds values
behind the older one, so shorter frames are prefixes of the longest. Names are the manual's, with _ for spaces; values
that it keeps for the maker's own software are called `unused`.
"""

from __future__ import annotations

from gateway.api.layout import Field, Layout

SOURCE = "Universal Robots, Realtime Client Interface (2021), RealTime 5.9 and RealTime 5.10"

_OWN = "Used by Universal Robots software only"

_FIELDS = (
    Field(name="message_size", offset=0, type="u32", meaning="Total length of the frame in bytes, these four included"),
    Field(name="time", offset=4, type="f64", unit="s", meaning="Time since the controller was started"),
    Field(name="q_target", offset=12, type="f64", count=6, unit="rad", meaning="Target joint positions, base to wrist 3"),
    Field(name="qd_target", offset=60, type="f64", count=6, unit="rad/s", meaning="Target joint velocities"),
    Field(name="qdd_target", offset=108, type="f64", count=6, unit="rad/s^2", meaning="Target joint accelerations"),
    Field(name="I_target", offset=156, type="f64", count=6, unit="A", meaning="Target joint currents"),
    Field(name="M_target", offset=204, type="f64", count=6, unit="Nm", meaning="Target joint moments (torques)"),
    Field(name="q_actual", offset=252, type="f64", count=6, unit="rad", meaning="Actual joint positions"),
    Field(name="qd_actual", offset=300, type="f64", count=6, unit="rad/s", meaning="Actual joint velocities"),
    Field(name="I_actual", offset=348, type="f64", count=6, unit="A", meaning="Actual joint currents"),
    Field(name="I_control", offset=396, type="f64", count=6, unit="A", meaning="Joint control currents"),
    Field(name="tool_vector_actual", offset=444, type="f64", count=6, unit="m|rad", meaning="Actual pose of the tool: x y z, and a rotation vector rx ry rz"),
    Field(name="TCP_speed_actual", offset=492, type="f64", count=6, unit="m/s|rad/s", meaning="Actual speed of the tool, linear and angular"),
    Field(name="TCP_force", offset=540, type="f64", count=6, unit="N|Nm", meaning="Generalised forces in the TCP"),
    Field(name="tool_vector_target", offset=588, type="f64", count=6, unit="m|rad", meaning="Target pose of the tool: x y z, and a rotation vector rx ry rz"),
    Field(name="TCP_speed_target", offset=636, type="f64", count=6, unit="m/s|rad/s", meaning="Target speed of the tool, linear and angular"),
    Field(name="digital_input_bits", offset=684, type="f64", meaning="Digital inputs as a whole number: 5 says that bits 0 and 2 are high"),
    Field(name="motor_temperatures", offset=692, type="f64", count=6, unit="degC", meaning="Temperature of each joint"),
    Field(name="controller_timer", offset=740, type="f64", meaning="Execution time of the controller's realtime thread; no unit is stated"),
    Field(name="test_value", offset=748, type="f64", meaning=_OWN),
    Field(name="robot_mode", offset=756, type="f64", meaning="-1 no controller, 0 disconnected, 1 confirm safety, 2 booting, 3 power off, 4 power on, 5 idle, 6 backdrive, 7 running, 8 updating firmware"),
    Field(name="joint_modes", offset=764, type="f64", count=6, meaning="235 reset, 236 shutting down, 238 backdrive, 239 power off, 240 ready for power off, 245 not responding, 246 motor initialisation, 247 booting, 249 bootloader, 251 violation, 252 fault, 253 running, 255 idle"),
    Field(name="safety_mode", offset=812, type="f64", meaning="1 normal, 2 reduced, 3 protective stop, 4 recovery, 5 safeguard stop, 6 system emergency stop, 7 robot emergency stop, 8 violation, 9 fault, 10 validate joint id, 11 undefined"),
    Field(name="unused_1", offset=820, type="f64", count=6, meaning=_OWN),
    Field(name="tool_accelerometer_values", offset=868, type="f64", count=3, meaning="Accelerometer of the tool, x y z; no unit is stated"),
    Field(name="unused_2", offset=892, type="f64", count=6, meaning=_OWN),
    Field(name="speed_scaling", offset=940, type="f64", meaning="Speed scaling of the trajectory limiter; it is not the speed slider"),
    Field(name="linear_momentum_norm", offset=948, type="f64", meaning="Norm of the Cartesian linear momentum"),
    Field(name="unused_3", offset=956, type="f64", meaning=_OWN),
    Field(name="unused_4", offset=964, type="f64", meaning=_OWN),
    Field(name="V_main", offset=972, type="f64", unit="V", meaning="Main voltage of the masterboard"),
    Field(name="V_robot", offset=980, type="f64", unit="V", meaning="Robot voltage (48 V) at the masterboard"),
    Field(name="I_robot", offset=988, type="f64", unit="A", meaning="Robot current at the masterboard"),
    Field(name="V_actual", offset=996, type="f64", count=6, unit="V", meaning="Actual joint voltages"),
    Field(name="digital_outputs", offset=1044, type="f64", meaning="Digital outputs as a whole number, bit by bit like the inputs"),
    Field(name="program_state", offset=1052, type="f64", meaning="0 stopping, 1 stopped, 2 playing, 3 pausing, 4 paused, 5 resuming"),
    Field(name="elbow_position", offset=1060, type="f64", count=3, unit="m", meaning="Position of the elbow"),
    Field(name="elbow_velocity", offset=1084, type="f64", count=3, unit="m/s", meaning="Velocity of the elbow"),
    Field(name="safety_status", offset=1108, type="f64", meaning="As safety_mode, and 12 automatic mode safeguard stop, 13 system three-position enabling stop, and further stops of newer software"),
    Field(name="unused_5", offset=1116, type="f64", meaning=_OWN),
    Field(name="unused_6", offset=1124, type="f64", meaning=_OWN),
    Field(name="unused_7", offset=1132, type="f64", meaning=_OWN),
    Field(name="payload_mass", offset=1140, type="f64", unit="kg", meaning="Payload mass"),
    Field(name="payload_CoG", offset=1148, type="f64", count=3, unit="m", meaning="Payload centre of gravity, x y z"),
    Field(name="payload_inertia", offset=1172, type="f64", count=6, meaning="Payload inertia in kg m^2: Ixx Iyy Izz Ixy Ixz Iyz"),
)  # fmt: skip

RT_1220 = Layout(
    name="1220", size=1220, fields=_FIELDS, source=SOURCE, byteorder=">", firmware="PolyScope 5.10 and later"
)

LAYOUTS = (
    RT_1220,
    RT_1220.prefix(1140, name="1140", firmware="PolyScope 5.9"),
    RT_1220.prefix(1116, name="1116", firmware="PolyScope 3.10 to 3.12, 5.4 to 5.6"),
    RT_1220.prefix(1108, name="1108", firmware="PolyScope 3.5 to 3.9, 5.0 to 5.3"),
    RT_1220.prefix(1060, name="1060", firmware="PolyScope 3.2 to 3.4"),
    RT_1220.prefix(1044, name="1044", firmware="PolyScope 3.0 and 3.1"),
)
