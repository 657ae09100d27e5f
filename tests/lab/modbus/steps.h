/* A PLC program in C: the step chain of an order on register map v1, for a client and for a server.
 * c: command block (PLC to cell), s: status block (cell to PLC), both as 16-bit words. */
#ifndef MIKADO_STEPS_H
#define MIKADO_STEPS_H

#include <stdint.h>
#include <stdio.h>
#include <time.h>

enum { C_VERSION = 0, C_BEAT, C_CONTROL, C_SEQ, C_CODE, C_RECIPE, C_ATTEMPTS = 8, C_ACK = 23, C_WORDS = 24 };
enum {
    S_VERSION = 0, S_BEAT, S_STATUS, S_STATE, S_ACCEPTED, S_ACK_CODE, S_RESULT_SEQ, S_RESULT_CODE,
    S_QUANTITY = 9, S_X = 12, S_WORDS = 40
};
enum { CONTROL_ENABLE = 1 };
enum { STATUS_READY = 1, STATUS_RESULT_VALID = 1 << 3, STATUS_PLC_LINK = 1 << 12 };
enum { COMMAND_PICK_AND_PLACE = 3 };

enum step { WAIT_LINK, WAIT_READY, WAIT_ANSWER, WAIT_RESULT, WAIT_DROP, DONE, FAILED };

struct program {
    enum step step;
    int orders;
    int finished;
    double since;
    double beat_at;
};

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + t.tv_nsec / 1e9;
}

static void go(struct program *p, enum step step)
{
    p->step = step;
    p->since = now_s();
}

static void fail(struct program *p, const char *what)
{
    printf("failed: %s\n", what);
    go(p, FAILED);
}

/* 32 bits, high word first, as a signed count */
static int32_t count_at(const uint16_t *words, int offset)
{
    return (int32_t)((uint32_t)words[offset] << 16 | words[offset + 1]);
}

static void scan(struct program *p, uint16_t *c, const uint16_t *s)
{
    double now = now_s();
    c[C_VERSION] = 1;
    if (now - p->beat_at >= 0.1) {
        c[C_BEAT]++;
        p->beat_at = now;
    }
    if (p->step != DONE && p->step != FAILED && now - p->since > 30.0)
        fail(p, "a step took 30 s");
    switch (p->step) {
    case WAIT_LINK:
        if (s[S_VERSION] == 1 && s[S_STATUS] & STATUS_PLC_LINK && now - p->since > 0.3) {
            c[C_CONTROL] |= CONTROL_ENABLE;
            go(p, WAIT_READY);
        }
        break;
    case WAIT_READY:
        if (s[S_STATUS] & STATUS_READY) {
            c[C_CODE] = COMMAND_PICK_AND_PLACE;
            c[C_RECIPE] = 1;
            c[C_ATTEMPTS] = 3;
            c[C_SEQ] = s[S_ACCEPTED] == 65535 ? 1 : s[S_ACCEPTED] + 1;
            printf("ordered %d\n", c[C_SEQ]);
            go(p, WAIT_ANSWER);
        }
        break;
    case WAIT_ANSWER:
        if (s[S_ACCEPTED] == c[C_SEQ]) {
            if (s[S_ACK_CODE] != 0) {
                printf("refused with %d\n", s[S_ACK_CODE]);
                fail(p, "refused");
            } else {
                printf("accepted %d\n", c[C_SEQ]);
                go(p, WAIT_RESULT);
            }
        }
        break;
    case WAIT_RESULT:
        if (s[S_STATUS] & STATUS_RESULT_VALID && s[S_RESULT_SEQ] == c[C_SEQ]) {
            printf("result %d code %d quantity %d x %d y %d z %d\n", s[S_RESULT_SEQ], s[S_RESULT_CODE],
                   s[S_QUANTITY], count_at(s, S_X), count_at(s, S_X + 2), count_at(s, S_X + 4));
            c[C_ACK] = s[S_RESULT_SEQ];
            go(p, WAIT_DROP);
        }
        break;
    case WAIT_DROP:
        if (!(s[S_STATUS] & STATUS_RESULT_VALID)) {
            printf("closed %d\n", c[C_SEQ]);
            p->finished++;
            go(p, p->finished == p->orders ? DONE : WAIT_READY);
        }
        break;
    case DONE:
    case FAILED:
        break;
    }
    fflush(stdout);
}

#endif
