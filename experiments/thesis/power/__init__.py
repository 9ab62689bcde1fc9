"""Power of the illuminator, frame rate, tumble between frames, and what the LEDs stand (thesis section 6.2, eq. 6.10)."""
