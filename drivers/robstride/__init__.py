"""RobStride motors on CAN, in the maker's private protocol."""
