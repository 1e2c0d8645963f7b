"""Where the probe goes to calibrate a cell, where each gimbal then looks, and what that will be worth."""
