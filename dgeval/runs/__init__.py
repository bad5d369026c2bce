"""Run folders: one trial's job, its files, many trials over processes, reading them back."""
