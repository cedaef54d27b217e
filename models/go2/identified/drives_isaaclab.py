"""Drives for Isaac Lab, with Isaac Sim 5.0 or later: before, friction was no effort.

Found by sdpid from commanded and measured positions under a known law.
"""

from isaaclab.actuators import DelayedPDActuatorCfg, ImplicitActuatorCfg

PHYSICS_STEP = 0.002  # s: that of your simulation
# 5.0 ms, but 0.0 to 8.4 ms stay open; with each ms armature changes by -0.0011 kg.m2 and damping by -0.01 N.m.s/rad; friction + (damping + kp*delay)*v is known 9.1 times better than damping alone
DELAY = 0.004991987873500347  # s, from a command to its effort
DELAY_STEPS = round(DELAY / PHYSICS_STEP)

# Knows no delay.
IMPLICIT = ImplicitActuatorCfg(
    joint_names_expr=['FL_hip_joint', 'FL_thigh_joint', 'FL_calf_joint', 'FR_hip_joint', 'FR_thigh_joint', 'FR_calf_joint', 'RL_hip_joint', 'RL_thigh_joint', 'RL_calf_joint', 'RR_hip_joint', 'RR_thigh_joint', 'RR_calf_joint'],
    stiffness={'FL_hip_joint': 20.0, 'FL_thigh_joint': 20.0, 'FL_calf_joint': 20.0, 'FR_hip_joint': 20.0, 'FR_thigh_joint': 20.0, 'FR_calf_joint': 20.0, 'RL_hip_joint': 20.0, 'RL_thigh_joint': 20.0, 'RL_calf_joint': 20.0, 'RR_hip_joint': 20.0, 'RR_thigh_joint': 20.0, 'RR_calf_joint': 20.0},
    damping={'FL_hip_joint': 1.5, 'FL_thigh_joint': 1.5, 'FL_calf_joint': 1.5, 'FR_hip_joint': 1.5, 'FR_thigh_joint': 1.5, 'FR_calf_joint': 1.5, 'RL_hip_joint': 1.5, 'RL_thigh_joint': 1.5, 'RL_calf_joint': 1.5, 'RR_hip_joint': 1.5, 'RR_thigh_joint': 1.5, 'RR_calf_joint': 1.5},
    armature={'FL_hip_joint': 1.8377807096188814e-09, 'FL_thigh_joint': 0.0, 'FL_calf_joint': 0.02460906585825924, 'FR_hip_joint': 0.0, 'FR_thigh_joint': 0.018135787977185173, 'FR_calf_joint': 0.021012889542995756, 'RL_hip_joint': 0.0, 'RL_thigh_joint': 0.009096593300170592, 'RL_calf_joint': 0.020457864057291313, 'RR_hip_joint': 0.0, 'RR_thigh_joint': 0.0036864218369458087, 'RR_calf_joint': 0.02197135511215772},
    friction={'FL_hip_joint': 0.31960611395620936, 'FL_thigh_joint': 0.18621666426670544, 'FL_calf_joint': 0.9770824384061414, 'FR_hip_joint': 0.1844181755665087, 'FR_thigh_joint': 0.18967784507574997, 'FR_calf_joint': 0.6446502902536357, 'RL_hip_joint': 0.158560413340505, 'RL_thigh_joint': 0.148727691078564, 'RL_calf_joint': 1.3693388277275922, 'RR_hip_joint': 0.22638516435254977, 'RR_thigh_joint': 0.2690865117037735, 'RR_calf_joint': 0.8142550282451764},
    dynamic_friction={'FL_hip_joint': 0.31960611395620936, 'FL_thigh_joint': 0.18621666426670544, 'FL_calf_joint': 0.9770824384061414, 'FR_hip_joint': 0.1844181755665087, 'FR_thigh_joint': 0.18967784507574997, 'FR_calf_joint': 0.6446502902536357, 'RL_hip_joint': 0.158560413340505, 'RL_thigh_joint': 0.148727691078564, 'RL_calf_joint': 1.3693388277275922, 'RR_hip_joint': 0.22638516435254977, 'RR_thigh_joint': 0.2690865117037735, 'RR_calf_joint': 0.8142550282451764},
    viscous_friction={'FL_hip_joint': 0.0, 'FL_thigh_joint': 0.15691323226793874, 'FL_calf_joint': 0.02925448745997778, 'FR_hip_joint': 0.18824069187296621, 'FR_thigh_joint': 0.08316074530370576, 'FR_calf_joint': 0.0003161064759372844, 'RL_hip_joint': 0.10289728374263898, 'RL_thigh_joint': 0.11955137283846473, 'RL_calf_joint': 0.0, 'RR_hip_joint': 0.12095702560032448, 'RR_thigh_joint': 0.08715830138684012, 'RR_calf_joint': 0.012821209821002945},
)

DELAYED = DelayedPDActuatorCfg(
    joint_names_expr=['FL_hip_joint', 'FL_thigh_joint', 'FL_calf_joint', 'FR_hip_joint', 'FR_thigh_joint', 'FR_calf_joint', 'RL_hip_joint', 'RL_thigh_joint', 'RL_calf_joint', 'RR_hip_joint', 'RR_thigh_joint', 'RR_calf_joint'],
    stiffness={'FL_hip_joint': 20.0, 'FL_thigh_joint': 20.0, 'FL_calf_joint': 20.0, 'FR_hip_joint': 20.0, 'FR_thigh_joint': 20.0, 'FR_calf_joint': 20.0, 'RL_hip_joint': 20.0, 'RL_thigh_joint': 20.0, 'RL_calf_joint': 20.0, 'RR_hip_joint': 20.0, 'RR_thigh_joint': 20.0, 'RR_calf_joint': 20.0},
    damping={'FL_hip_joint': 1.5, 'FL_thigh_joint': 1.5, 'FL_calf_joint': 1.5, 'FR_hip_joint': 1.5, 'FR_thigh_joint': 1.5, 'FR_calf_joint': 1.5, 'RL_hip_joint': 1.5, 'RL_thigh_joint': 1.5, 'RL_calf_joint': 1.5, 'RR_hip_joint': 1.5, 'RR_thigh_joint': 1.5, 'RR_calf_joint': 1.5},
    armature={'FL_hip_joint': 1.8377807096188814e-09, 'FL_thigh_joint': 0.0, 'FL_calf_joint': 0.02460906585825924, 'FR_hip_joint': 0.0, 'FR_thigh_joint': 0.018135787977185173, 'FR_calf_joint': 0.021012889542995756, 'RL_hip_joint': 0.0, 'RL_thigh_joint': 0.009096593300170592, 'RL_calf_joint': 0.020457864057291313, 'RR_hip_joint': 0.0, 'RR_thigh_joint': 0.0036864218369458087, 'RR_calf_joint': 0.02197135511215772},
    friction={'FL_hip_joint': 0.31960611395620936, 'FL_thigh_joint': 0.18621666426670544, 'FL_calf_joint': 0.9770824384061414, 'FR_hip_joint': 0.1844181755665087, 'FR_thigh_joint': 0.18967784507574997, 'FR_calf_joint': 0.6446502902536357, 'RL_hip_joint': 0.158560413340505, 'RL_thigh_joint': 0.148727691078564, 'RL_calf_joint': 1.3693388277275922, 'RR_hip_joint': 0.22638516435254977, 'RR_thigh_joint': 0.2690865117037735, 'RR_calf_joint': 0.8142550282451764},
    dynamic_friction={'FL_hip_joint': 0.31960611395620936, 'FL_thigh_joint': 0.18621666426670544, 'FL_calf_joint': 0.9770824384061414, 'FR_hip_joint': 0.1844181755665087, 'FR_thigh_joint': 0.18967784507574997, 'FR_calf_joint': 0.6446502902536357, 'RL_hip_joint': 0.158560413340505, 'RL_thigh_joint': 0.148727691078564, 'RL_calf_joint': 1.3693388277275922, 'RR_hip_joint': 0.22638516435254977, 'RR_thigh_joint': 0.2690865117037735, 'RR_calf_joint': 0.8142550282451764},
    viscous_friction={'FL_hip_joint': 0.0, 'FL_thigh_joint': 0.15691323226793874, 'FL_calf_joint': 0.02925448745997778, 'FR_hip_joint': 0.18824069187296621, 'FR_thigh_joint': 0.08316074530370576, 'FR_calf_joint': 0.0003161064759372844, 'RL_hip_joint': 0.10289728374263898, 'RL_thigh_joint': 0.11955137283846473, 'RL_calf_joint': 0.0, 'RR_hip_joint': 0.12095702560032448, 'RR_thigh_joint': 0.08715830138684012, 'RR_calf_joint': 0.012821209821002945},
    min_delay=DELAY_STEPS,
    max_delay=DELAY_STEPS,
)
