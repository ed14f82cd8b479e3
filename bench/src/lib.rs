//! The simulated rig: the drivers' simulators joined to a phantom, in memory or on TCP.
