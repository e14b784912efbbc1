// Reads bytes from standard input and says, line by line, what the firmware's codec makes of them.
#include <stdio.h>
#include <unistd.h>

#include "frame.h"
#include "request.h"

static void tell(const char *payload) {
  Request request;
  switch (parse(payload, 255, request)) {
    case Verdict::kOk:
      if (request.verb == 'P') {
        printf("P %u %d\n", request.sequence, request.pwm);
      } else {
        printf("%c %u\n", request.verb, request.sequence);
      }
      return;
    case Verdict::kSyntax: printf(request.has_sequence ? "E %u SYNTAX\n" : "E - SYNTAX\n", request.sequence); return;
    case Verdict::kUnknown: printf("E %u UNKNOWN\n", request.sequence); return;
    case Verdict::kRange: printf("E %u RANGE\n", request.sequence); return;
  }
}

int main() {
  frame::Reader reader;
  int byte;
  while ((byte = getchar()) != EOF) {
    switch (reader.take(static_cast<char>(byte))) {
      case frame::Event::kNone: break;
      case frame::Event::kFrame: tell(reader.payload()); break;
      case frame::Event::kDamaged: printf("E - CRC\n"); break;
      case frame::Event::kTooLong: printf("E - TOO_LONG\n"); break;
    }
  }
  char line[frame::kMaxLine + 1];
  line[frame::seal("S 65535 4294967295 -255 1023 255", line)] = '\0';
  printf("%s%04X\n", line, frame::crc16("123456789", 9));
}
