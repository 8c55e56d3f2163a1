"""hil: record a locked joint, identify the stiffness and damping of its coupling."""
