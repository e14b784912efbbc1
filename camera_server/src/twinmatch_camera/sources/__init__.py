"""Where frames come from: each source is a module here, and none imports what another needs.

`base` says what a source is. `lepton` reads a FLIR Lepton over SPI, `v4l2` a video device that delivers
Y16, `emulated` makes images of a plate from the temperatures it receives, `followed` the same at times that
it receives too, `recorded` plays frames from a file. `vospi`, `telemetry` and `cci` are the Lepton's
protocols, without a wire, for `lepton` and for tests.
"""
