"""An online run as one file, and the same run again to see that every bit of it comes out as it did."""
