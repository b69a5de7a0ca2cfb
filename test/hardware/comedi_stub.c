/* Two cards with comedilib's functions: /dev/stub0 has 12-bit inputs of +-10 V, /dev/stub1 a 16-bit output of +-10 V. */
#include <math.h>
#include <string.h>

typedef struct { double min, max; unsigned int unit; } comedi_range;
typedef struct { int open, inputs; } card;

static card cards[2] = {{0, 16}, {0, 2}};
static comedi_range volts = {-10.0, 10.0, 0};
static int out_of_range_nan = 1;

/* Set and read by the test. */
unsigned int stub_codes[16];
unsigned int stub_written = 0xdead, stub_writes = 0, stub_channel, stub_reference;
int stub_broken = 0;

void *comedi_open(const char *name) {
    int index = !strcmp(name, "/dev/stub0") ? 0 : !strcmp(name, "/dev/stub1") ? 1 : -1;
    if (index < 0) return 0;
    cards[index].open++;
    return &cards[index];
}
int comedi_close(void *it) { ((card *)it)->open--; return 0; }
int stub_open(void) { return cards[0].open + cards[1].open; }
int comedi_errno(void) { return 5; }
const char *comedi_strerror(int number) { return number == 5 ? "stub error" : "other"; }
int comedi_set_global_oor_behavior(int behaviour) { out_of_range_nan = behaviour; return 1; }
int comedi_get_n_channels(void *it, unsigned int subdevice) { return subdevice == 0 ? ((card *)it)->inputs : -1; }
unsigned int comedi_get_maxdata(void *it, unsigned int s, unsigned int c) { return it == &cards[0] ? 4095 : 65535; }
int comedi_find_range(void *it, unsigned int s, unsigned int c, unsigned int unit, double min, double max) {
    return unit == 0 && min >= -10.0 && max <= 10.0 ? 3 : -1;
}
comedi_range *comedi_get_range(void *it, unsigned int s, unsigned int c, unsigned int range) { return range == 3 ? &volts : 0; }
double comedi_to_phys(unsigned int code, comedi_range *r, unsigned int largest) {
    if (out_of_range_nan && (code == 0 || code == largest)) return NAN;
    return r->min + (r->max - r->min) * code / largest;
}
unsigned int comedi_from_phys(double value, comedi_range *r, unsigned int largest) {
    double code = floor((value - r->min) / (r->max - r->min) * largest + 0.5);
    return code < 0 ? 0 : code > largest ? largest : (unsigned int)code;
}
int comedi_data_read(void *it, unsigned int s, unsigned int c, unsigned int range, unsigned int reference, unsigned int *code) {
    if (stub_broken || it != &cards[0] || range != 3) return -1;
    stub_reference = reference;
    *code = stub_codes[c];
    return 1;
}
int comedi_data_write(void *it, unsigned int s, unsigned int c, unsigned int range, unsigned int reference, unsigned int code) {
    if (stub_broken || it != &cards[1] || range != 3) return -1;
    stub_writes++;
    stub_channel = c;
    stub_written = code;
    return 1;
}
