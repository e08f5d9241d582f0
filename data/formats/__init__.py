"""What files hold, as tables: one file for each kind."""
