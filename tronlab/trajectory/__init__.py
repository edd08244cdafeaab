"""Camera poses of a campaign, in the order they are flown."""
