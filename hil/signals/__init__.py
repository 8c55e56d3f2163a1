"""From the rows of a recording to torque, deflection and rate, and a check of their quality."""
