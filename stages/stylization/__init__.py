"""From the options of a stylization to the settings of its trainer."""
