"""Import of the trial folders of the robot HIRO."""
