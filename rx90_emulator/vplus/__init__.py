"""V+, the language of the Adept system in the CS7B: its programs and its monitor on the emulated arm."""
