"""What reproduces and corrects the thesis."""
