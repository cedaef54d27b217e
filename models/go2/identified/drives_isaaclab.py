"""Drives for Isaac Lab, with Isaac Sim 5.0 or later: before, friction was no effort.

Found by sdpid from commanded and measured positions under a known law.
"""

from isaaclab.actuators import DelayedPDActuatorCfg, ImplicitActuatorCfg

PHYSICS_STEP = 0.002  # s: that of your simulation
# 5.0 ms, but 0.0 to 8.4 ms stay open; with each ms armature changes by -0.0011 kg.m2 and damping by -0.01 N.m.s/rad; friction + (damping + kp*delay)*v is known 9.1 times better than damping alone
DELAY = 0.004991987053763724  # s, from a command to its effort
DELAY_STEPS = round(DELAY / PHYSICS_STEP)

# Knows no delay.
IMPLICIT = ImplicitActuatorCfg(
    joint_names_expr=['FL_hip_joint', 'FL_thigh_joint', 'FL_calf_joint', 'FR_hip_joint', 'FR_thigh_joint', 'FR_calf_joint', 'RL_hip_joint', 'RL_thigh_joint', 'RL_calf_joint', 'RR_hip_joint', 'RR_thigh_joint', 'RR_calf_joint'],
    stiffness={'FL_hip_joint': 20.0, 'FL_thigh_joint': 20.0, 'FL_calf_joint': 20.0, 'FR_hip_joint': 20.0, 'FR_thigh_joint': 20.0, 'FR_calf_joint': 20.0, 'RL_hip_joint': 20.0, 'RL_thigh_joint': 20.0, 'RL_calf_joint': 20.0, 'RR_hip_joint': 20.0, 'RR_thigh_joint': 20.0, 'RR_calf_joint': 20.0},
    damping={'FL_hip_joint': 1.5, 'FL_thigh_joint': 1.5, 'FL_calf_joint': 1.5, 'FR_hip_joint': 1.5, 'FR_thigh_joint': 1.5, 'FR_calf_joint': 1.5, 'RL_hip_joint': 1.5, 'RL_thigh_joint': 1.5, 'RL_calf_joint': 1.5, 'RR_hip_joint': 1.5, 'RR_thigh_joint': 1.5, 'RR_calf_joint': 1.5},
    armature={'FL_hip_joint': 1.8395266852450394e-09, 'FL_thigh_joint': 0.0, 'FL_calf_joint': 0.02460906731546353, 'FR_hip_joint': 0.0, 'FR_thigh_joint': 0.018135787381977134, 'FR_calf_joint': 0.02101289168586064, 'RL_hip_joint': 0.0, 'RL_thigh_joint': 0.009096595484036447, 'RL_calf_joint': 0.02045786533474168, 'RR_hip_joint': 0.0, 'RR_thigh_joint': 0.0036864207309337976, 'RR_calf_joint': 0.0219713568031612},
    friction={'FL_hip_joint': 0.319606121249346, 'FL_thigh_joint': 0.18621668657531382, 'FL_calf_joint': 0.977082431062875, 'FR_hip_joint': 0.18441811935186797, 'FR_thigh_joint': 0.1896778464383232, 'FR_calf_joint': 0.6446502926129982, 'RL_hip_joint': 0.1585604245384029, 'RL_thigh_joint': 0.1487276950483451, 'RL_calf_joint': 1.369338842588392, 'RR_hip_joint': 0.22638514692460537, 'RR_thigh_joint': 0.2690865008183077, 'RR_calf_joint': 0.8142550245811224},
    dynamic_friction={'FL_hip_joint': 0.319606121249346, 'FL_thigh_joint': 0.18621668657531382, 'FL_calf_joint': 0.977082431062875, 'FR_hip_joint': 0.18441811935186797, 'FR_thigh_joint': 0.1896778464383232, 'FR_calf_joint': 0.6446502926129982, 'RL_hip_joint': 0.1585604245384029, 'RL_thigh_joint': 0.1487276950483451, 'RL_calf_joint': 1.369338842588392, 'RR_hip_joint': 0.22638514692460537, 'RR_thigh_joint': 0.2690865008183077, 'RR_calf_joint': 0.8142550245811224},
    viscous_friction={'FL_hip_joint': 0.0, 'FL_thigh_joint': 0.15691320644327242, 'FL_calf_joint': 0.029254511012514032, 'FR_hip_joint': 0.18824083663271185, 'FR_thigh_joint': 0.08316075863831293, 'FR_calf_joint': 0.0003161201208082892, 'RL_hip_joint': 0.10289727519330298, 'RL_thigh_joint': 0.11955138190124737, 'RL_calf_joint': 0.0, 'RR_hip_joint': 0.12095707997576555, 'RR_thigh_joint': 0.08715833796353159, 'RR_calf_joint': 0.012821230084205978},
)

DELAYED = DelayedPDActuatorCfg(
    joint_names_expr=['FL_hip_joint', 'FL_thigh_joint', 'FL_calf_joint', 'FR_hip_joint', 'FR_thigh_joint', 'FR_calf_joint', 'RL_hip_joint', 'RL_thigh_joint', 'RL_calf_joint', 'RR_hip_joint', 'RR_thigh_joint', 'RR_calf_joint'],
    stiffness={'FL_hip_joint': 20.0, 'FL_thigh_joint': 20.0, 'FL_calf_joint': 20.0, 'FR_hip_joint': 20.0, 'FR_thigh_joint': 20.0, 'FR_calf_joint': 20.0, 'RL_hip_joint': 20.0, 'RL_thigh_joint': 20.0, 'RL_calf_joint': 20.0, 'RR_hip_joint': 20.0, 'RR_thigh_joint': 20.0, 'RR_calf_joint': 20.0},
    damping={'FL_hip_joint': 1.5, 'FL_thigh_joint': 1.5, 'FL_calf_joint': 1.5, 'FR_hip_joint': 1.5, 'FR_thigh_joint': 1.5, 'FR_calf_joint': 1.5, 'RL_hip_joint': 1.5, 'RL_thigh_joint': 1.5, 'RL_calf_joint': 1.5, 'RR_hip_joint': 1.5, 'RR_thigh_joint': 1.5, 'RR_calf_joint': 1.5},
    armature={'FL_hip_joint': 1.8395266852450394e-09, 'FL_thigh_joint': 0.0, 'FL_calf_joint': 0.02460906731546353, 'FR_hip_joint': 0.0, 'FR_thigh_joint': 0.018135787381977134, 'FR_calf_joint': 0.02101289168586064, 'RL_hip_joint': 0.0, 'RL_thigh_joint': 0.009096595484036447, 'RL_calf_joint': 0.02045786533474168, 'RR_hip_joint': 0.0, 'RR_thigh_joint': 0.0036864207309337976, 'RR_calf_joint': 0.0219713568031612},
    friction={'FL_hip_joint': 0.319606121249346, 'FL_thigh_joint': 0.18621668657531382, 'FL_calf_joint': 0.977082431062875, 'FR_hip_joint': 0.18441811935186797, 'FR_thigh_joint': 0.1896778464383232, 'FR_calf_joint': 0.6446502926129982, 'RL_hip_joint': 0.1585604245384029, 'RL_thigh_joint': 0.1487276950483451, 'RL_calf_joint': 1.369338842588392, 'RR_hip_joint': 0.22638514692460537, 'RR_thigh_joint': 0.2690865008183077, 'RR_calf_joint': 0.8142550245811224},
    dynamic_friction={'FL_hip_joint': 0.319606121249346, 'FL_thigh_joint': 0.18621668657531382, 'FL_calf_joint': 0.977082431062875, 'FR_hip_joint': 0.18441811935186797, 'FR_thigh_joint': 0.1896778464383232, 'FR_calf_joint': 0.6446502926129982, 'RL_hip_joint': 0.1585604245384029, 'RL_thigh_joint': 0.1487276950483451, 'RL_calf_joint': 1.369338842588392, 'RR_hip_joint': 0.22638514692460537, 'RR_thigh_joint': 0.2690865008183077, 'RR_calf_joint': 0.8142550245811224},
    viscous_friction={'FL_hip_joint': 0.0, 'FL_thigh_joint': 0.15691320644327242, 'FL_calf_joint': 0.029254511012514032, 'FR_hip_joint': 0.18824083663271185, 'FR_thigh_joint': 0.08316075863831293, 'FR_calf_joint': 0.0003161201208082892, 'RL_hip_joint': 0.10289727519330298, 'RL_thigh_joint': 0.11955138190124737, 'RL_calf_joint': 0.0, 'RR_hip_joint': 0.12095707997576555, 'RR_thigh_joint': 0.08715833796353159, 'RR_calf_joint': 0.012821230084205978},
    min_delay=DELAY_STEPS,
    max_delay=DELAY_STEPS,
)
