"""What a drive is: registers, models, scaling, and the catalogue that holds them as data."""
