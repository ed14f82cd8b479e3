//! The seams of a rig, the one place that waits on a wire, and the acquisition of a plan.
