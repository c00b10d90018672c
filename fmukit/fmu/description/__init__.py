"""modelDescription.xml of either version of FMI."""
