"""Large problems: who does which job, whole tours decided one after the other, and better ones."""
