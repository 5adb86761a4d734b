"""Readers and writers of file formats. A file that is not what it should be gets one line that says where and why."""
