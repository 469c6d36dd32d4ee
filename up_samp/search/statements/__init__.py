"""What is stated of motions: before the first schedule, and whenever a check tells more."""
