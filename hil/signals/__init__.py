"""From the rows of a recording to torque, deflection and rate, with a check of their quality."""
