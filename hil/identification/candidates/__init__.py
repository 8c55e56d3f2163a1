"""Model selection: find the terms that improve the score of a recording, and other causes of a delayed torque."""
