"""Commands on many trials, on the results of finished trials, on recordings or on the installation."""
