"""The driver of motors on SimpleFOC boards, which are commanded with the library's text protocol, Commander."""
