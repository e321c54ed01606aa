"""The one door for every write: who may command a drive, what a command comes to, and what became of it."""
