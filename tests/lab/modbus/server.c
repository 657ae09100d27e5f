/* A PLC that is the Modbus server: libmodbus serves holding registers 0-299, the cell polls; orders picks.
 *     server PORT ORDERS
 * Exit code 0: every order was closed, and the test registers were written. */
#include <errno.h>
#include <modbus.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <unistd.h>

#include "steps.h"

enum { STATUS_BASE = 100, TEST_BASE = 200, REGISTERS = 300 };

int main(int argc, char **argv)
{
    const uint16_t test[8] = {0x1234, 0xCFC7, 0x1234, 0x5678, 0xFFFE, 0x1DC0, 1, 1};
    struct program program = {.step = WAIT_LINK};
    modbus_mapping_t *map = modbus_mapping_new(0, 0, REGISTERS, 0);
    modbus_t *plc;
    int listening, connected = -1;

    if (argc != 3 || map == NULL)
        return 2;
    plc = modbus_new_tcp("127.0.0.1", atoi(argv[1]));
    listening = plc == NULL ? -1 : modbus_tcp_listen(plc, 1);
    if (listening == -1) {
        printf("failed: %s\n", modbus_strerror(errno));
        return 1;
    }
    printf("listening\n");
    fflush(stdout);
    program.orders = atoi(argv[2]);
    program.since = now_s();
    while (program.step != DONE && program.step != FAILED) {
        struct timeval scan_time = {0, 10000};
        fd_set ready;
        FD_ZERO(&ready);
        FD_SET(connected == -1 ? listening : connected, &ready);
        if (select((connected == -1 ? listening : connected) + 1, &ready, NULL, NULL, &scan_time) > 0) {
            if (connected == -1) {
                connected = modbus_tcp_accept(plc, &listening);
            } else {
                uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
                int length = modbus_receive(plc, query);
                if (length > 0) {
                    modbus_reply(plc, query, length, map);
                } else if (length == -1) {
                    close(connected);
                    connected = -1;
                }
            }
        }
        scan(&program, map->tab_registers, map->tab_registers + STATUS_BASE);
    }
    if (memcmp(map->tab_registers + TEST_BASE, test, sizeof test) != 0)
        fail(&program, "the test registers were not written");
    else
        printf("ok: test registers\n");
    modbus_close(plc);
    modbus_free(plc);
    modbus_mapping_free(map);
    return program.step != DONE;
}
