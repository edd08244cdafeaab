"""What a laboratory device must do, what it reports, and how one is found."""
