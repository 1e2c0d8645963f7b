/* A gimbal controller on libmodbus: the independent peer of the modbus driver. It knows the map's registers and nothing of ours.
 *
 * usage: modbus_peer STATIC_HEX STATUS_HEX [no23]
 * The two blocks are big-endian hex of holding registers 200.. and 100..; the port is printed on stdout. A command record with equal
 * guards is echoed in register 104, and every request that reads the status counts both of its guards. "no23" refuses function 23.
 * Ends when stdin closes.
 */
#include <errno.h>
#include <modbus.h>
#include <netinet/in.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

enum { COMMAND = 0, STATUS = 100, STATIC = 200, SEQ = 101, ECHO = 104, SEQ_COPY = 149, REGISTERS = 512 };

static void fill(uint16_t *registers, const char *hex) {
    for (size_t n = 0; n < strlen(hex) / 4; n++) {
        char word[5] = {hex[4 * n], hex[4 * n + 1], hex[4 * n + 2], hex[4 * n + 3], 0};
        registers[n] = (uint16_t)strtoul(word, NULL, 16);
    }
}

static int listen_on_loopback(void) {
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    socklen_t size = sizeof address;
    int fd = socket(AF_INET, SOCK_STREAM, 0);
    if (fd < 0 || bind(fd, (struct sockaddr *)&address, size) || listen(fd, 4)) exit(2);
    getsockname(fd, (struct sockaddr *)&address, &size);
    printf("%d\n", ntohs(address.sin_port));
    fflush(stdout);
    return fd;
}

/* The record as the request brings it, not yet in the registers: echo it first, so that function 23 reads its own echo. */
static void accept_command(uint16_t *registers, const uint8_t *pdu) {
    int at_write = pdu[0] == 23 ? 5 : 1, values = at_write + 5;
    int address = pdu[at_write] << 8 | pdu[at_write + 1], count = pdu[at_write + 2] << 8 | pdu[at_write + 3];
    if (address != COMMAND || count != 16) return;
    uint16_t seq = (uint16_t)(pdu[values + 2] << 8 | pdu[values + 3]);
    uint16_t copy = (uint16_t)(pdu[values + 30] << 8 | pdu[values + 31]);
    if (seq == copy) registers[ECHO] = seq;
}

static void serve(modbus_t *bus, modbus_mapping_t *map, int no23) {
    uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
    int header = modbus_get_header_length(bus), length;
    while ((length = modbus_receive(bus, query)) >= 0) {
        const uint8_t *pdu = query + header;
        uint16_t *registers = map->tab_registers;
        if (length == 0) continue;
        if (pdu[0] == 23 && no23) {
            modbus_reply_exception(bus, query, MODBUS_EXCEPTION_ILLEGAL_FUNCTION);
            continue;
        }
        if (pdu[0] == 16 || pdu[0] == 23) accept_command(registers, pdu);
        registers[SEQ_COPY] = ++registers[SEQ];
        modbus_reply(bus, query, length, map);
    }
}

int main(int argc, char **argv) {
    if (argc < 3) return 1;
    modbus_t *bus = modbus_new_tcp("127.0.0.1", 0);
    modbus_mapping_t *map = modbus_mapping_new(0, 0, REGISTERS, REGISTERS);
    fill(map->tab_registers + STATIC, argv[1]);
    fill(map->tab_registers + STATUS, argv[2]);
    struct pollfd watched[2] = {{.fd = listen_on_loopback(), .events = POLLIN}, {.fd = STDIN_FILENO, .events = POLLIN}};
    for (;;) {
        if (poll(watched, 2, -1) < 0 && errno != EINTR) return 3;
        if (watched[1].revents) return 0;
        if (!watched[0].revents) continue;
        modbus_tcp_accept(bus, &watched[0].fd);
        serve(bus, map, argc > 3);
        modbus_close(bus);
    }
}
