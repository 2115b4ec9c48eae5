"""Work that is killed at random moments and gone on with, compared with the same undisturbed."""
