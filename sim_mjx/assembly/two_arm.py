"""Two arms: the right hand presses the male part sideways into the female part, which the left hand holds.

The one-arm task turned by 90 degrees about the forward axis: "up the hand" is to the robot's right, and the hand
turns about the vertical. Wrenches are logged in each wrist's own frame, as the recordings have them.
"""
