"""CubeMars AK and Damiao motors on CAN, which use the frames of the MIT mini-cheetah."""
