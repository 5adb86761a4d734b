"""Readers and writers of file formats. An invalid file gets one line that says what is wrong and where."""
