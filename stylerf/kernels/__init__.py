"""The hot steps, each behind one signature with an exact backward."""
