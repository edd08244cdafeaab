"""What can be known of a campaign before the robot moves."""
