"""What a failed check tells the scheduler: one module for each kind of cut."""
