"""The command line (room: cli): verbs parse, call one public function and write files; nobody imports this room."""
