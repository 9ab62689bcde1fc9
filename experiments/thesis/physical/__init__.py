"""The physical experiment of thesis sections 7.1 and 8.2, emulated: arm, camera, lamp and mock-up, rendered."""
