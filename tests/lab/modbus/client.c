/* A PLC that is the Modbus client: polls the cell with libmodbus, tries every function code, orders picks.
 *     client HOST PORT ORDERS
 * Exit code 0: every check held and every order was closed. */
#include <errno.h>
#include <modbus.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "steps.h"

static int bad;

static void check(const char *what, int good)
{
    printf("%s: %s\n", good ? "ok" : "WRONG", what);
    bad += !good;
}

static void check_functions(modbus_t *cell)
{
    uint16_t words[S_WORDS], mirror[S_WORDS], one[1];
    uint8_t bits[16], more[20];
    const uint16_t test[8] = {0x1234, 0xCFC7, 0x1234, 0x5678, 0xFFFE, 0x1DC0, 1, 1};
    int i, same = 1;

    check("FC4 test registers", modbus_read_input_registers(cell, 200, 8, words) == 8
                                    && memcmp(words, test, sizeof test) == 0);
    check("FC3 test registers", modbus_read_registers(cell, 200, 8, words) == 8
                                    && memcmp(words, test, sizeof test) == 0);
    check("FC4 status", modbus_read_input_registers(cell, 0, S_WORDS, words) == S_WORDS && words[0] == 1);
    check("FC3 mirrored status", modbus_read_registers(cell, 100, S_WORDS, mirror) == S_WORDS);
    check("both show the same result", memcmp(words + 4, mirror + 4, 24 * sizeof *words) == 0);
    check("FC2 status bits", modbus_read_input_bits(cell, 0, 16, bits) == 16);
    check("FC4 status word", modbus_read_input_registers(cell, 2, 1, one) == 1);
    for (i = 0; i < 16; i++)
        same &= bits[i] == (one[0] >> i & 1);
    check("bits of the status word are the discrete inputs", same);

    check("FC6", modbus_write_register(cell, 5, 7) == 1);
    check("FC3 reads it back", modbus_read_registers(cell, 5, 1, one) == 1 && one[0] == 7);
    check("FC22", modbus_mask_write_register(cell, 5, 0xFFFE, 0x0008) == 1);
    check("FC3 reads it back", modbus_read_registers(cell, 5, 1, one) == 1 && one[0] == 6);
    check("FC5", modbus_write_bit(cell, 4, 1) == 1);
    check("FC1 reads it back", modbus_read_bits(cell, 0, 16, bits) == 16 && bits[4] == 1);
    memset(bits, 0, sizeof bits);
    check("FC15", modbus_write_bits(cell, 0, 6, bits) == 6);
    check("FC3 reads it back", modbus_read_registers(cell, 2, 1, one) == 1 && one[0] == 0);
    one[0] = 0;
    check("FC23", modbus_write_and_read_registers(cell, 5, 1, one, 100, S_WORDS, words) == S_WORDS
                      && words[0] == 1);

    check("FC16 into the status is refused", modbus_write_register(cell, 100, 1) == -1 && errno == EMBXILADD);
    check("a read beyond the block is refused",
          modbus_read_registers(cell, 20, 10, words) == -1 && errno == EMBXILADD);
    check("coil 16 is refused", modbus_read_bits(cell, 0, 20, more) == -1 && errno == EMBXILADD);
    check("FC17 is refused", modbus_report_slave_id(cell, sizeof more, more) == -1 && errno == EMBXILFUN);
}

int main(int argc, char **argv)
{
    uint16_t c[C_WORDS] = {1}, s[S_WORDS] = {0};
    struct program program = {.step = WAIT_LINK};
    modbus_t *cell;

    if (argc != 4)
        return 2;
    cell = modbus_new_tcp(argv[1], atoi(argv[2]));
    if (cell == NULL || modbus_connect(cell) == -1) {
        printf("failed: no connection: %s\n", modbus_strerror(errno));
        return 1;
    }
    if (modbus_write_registers(cell, 0, C_WORDS, c) != C_WORDS) {
        printf("failed: %s\n", modbus_strerror(errno));
        return 1;
    }
    check_functions(cell);
    program.orders = atoi(argv[3]);
    program.since = now_s();
    while (program.step != DONE && program.step != FAILED) {
        if (modbus_write_registers(cell, 0, C_WORDS, c) != C_WORDS
            || modbus_read_input_registers(cell, 0, S_WORDS, s) != S_WORDS) {
            printf("failed: %s\n", modbus_strerror(errno));
            return 1;
        }
        scan(&program, c, s);
        usleep(20000);
    }
    modbus_close(cell);
    modbus_free(cell);
    return bad || program.step != DONE;
}
