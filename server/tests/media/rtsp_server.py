"""RTSP camera for tests: rtsp_server.py ENCODER WIDTH HEIGHT [PORT], or rtsp_server.py file PATH [PORT].

Prints its port. For each generated frame it then prints the number and the capture time in ns since the Unix epoch.
The number is drawn into the picture as sixteen blocks, highest bit first, dark for 0 and light for 1. A file is
served unchanged, in real time.
"""

import sys
import threading
import time

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer  # noqa: E402

RATE = 25
BLOCKS = 16
ENCODERS = {
    "jpeg": "jpegenc ! rtpjpegpay name=pay0",
    "h264": "x264enc tune=zerolatency speed-preset=ultrafast key-int-max=10 ! rtph264pay name=pay0 config-interval=1",
    "h265": "x265enc tune=zerolatency speed-preset=ultrafast key-int-max=10 ! h265parse ! rtph265pay name=pay0 config-interval=1",
}


def picture(number, width, height):
    """A picture with the number as blocks in the luma, and grey chroma."""
    row = bytearray()
    for u in range(width):
        bit = BLOCKS - 1 - u * BLOCKS // width
        row.append(200 if number >> bit & 1 else 50)
    return bytes(row) * height + bytes([128]) * (width * height // 2)


class Factory(GstRtspServer.RTSPMediaFactory):
    def __init__(self, encoder, width, height):
        super().__init__()
        self.size = width, height
        self.set_shared(True)
        caps = f"video/x-raw,format=I420,width={width},height={height},framerate={RATE}/1"
        self.set_launch(
            f"( appsrc name=origin is-live=true do-timestamp=true format=time caps={caps} ! {ENCODERS[encoder]} )"
        )
        self.connect("media-configure", lambda _, media: self.begin(media))

    def begin(self, media):
        origin = media.get_element().get_by_name_recurse_up("origin")
        ended = threading.Event()
        media.connect("unprepared", lambda _: ended.set())
        threading.Thread(target=self.push, args=(origin, ended), daemon=True).start()

    def push(self, origin, ended):
        # Frames are stamped with the running time when they are pushed. Without a base time the stamp would be the
        # machine's uptime, and the frame would be due far in the future.
        while origin.get_base_time() == 0 and not ended.is_set():
            time.sleep(0.001)
        begun = time.monotonic()
        number = 0
        while not ended.is_set():
            time.sleep(max(0.0, begun + number / RATE - time.monotonic()))
            buffer = Gst.Buffer.new_wrapped(picture(number, *self.size))
            print(number, time.time_ns(), flush=True)
            origin.emit("push-buffer", buffer)
            number += 1


def main():
    Gst.init(None)
    arguments = sys.argv[1:]
    if arguments[0] == "file":
        factory = GstRtspServer.RTSPMediaFactory()
        path = arguments[1].replace('"', '\\"')
        factory.set_launch(
            f'( filesrc location="{path}" ! qtdemux ! h264parse ! rtph264pay name=pay0 config-interval=1 )'
        )
        rest = arguments[2:]
    else:
        factory = Factory(arguments[0], int(arguments[1]), int(arguments[2]))
        rest = arguments[3:]
    server = GstRtspServer.RTSPServer()
    server.set_address("127.0.0.1")
    server.set_service(rest[0] if rest else "0")
    server.get_mount_points().add_factory("/stream", factory)
    server.attach(None)
    print(server.get_bound_port(), flush=True)
    GLib.MainLoop().run()


main()
