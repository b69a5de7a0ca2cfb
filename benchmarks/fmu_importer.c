/* Steps an FMU for Co-Simulation through the importer of the Modelica Association's Reference FMUs (src/FMI*.c), which shares no
   code with FMPy, and prints the outputs of the last step as hexadecimal numbers.

   fmu_importer VERSION LIBRARY TOKEN COMMAND_REFERENCE STEPS OUTPUT_REFERENCE... */
#include <stdio.h>
#include <stdlib.h>

#include "FMI.h"
#include "FMI2.h"
#include "FMI3.h"

#define PERIOD 1e-3
#define CHECK(call) do { if ((call) > FMIWarning) { fprintf(stderr, "%s failed\n", #call); return 1; } } while (0)

static void log_message(FMIInstance *instance, FMIStatus status, const char *category, const char *message) {
    fprintf(stderr, "%s\n", message);
}

int main(int count, char **words) {
    if (count < 7) return 2;
    int third = words[1][0] == '3';
    unsigned int command = (unsigned int)atoi(words[4]);
    long steps = atol(words[5]);
    FMIInstance *m = FMICreateInstance("rig", log_message, NULL);
    CHECK(FMILoadPlatformBinary(m, words[2]));
    if (third) {
        CHECK(FMI3InstantiateCoSimulation(m, words[3], NULL, 0, 0, 0, 0, NULL, 0, NULL));
        CHECK(FMI3EnterInitializationMode(m, 0, 0.0, 0.0, 0, 0.0));
        CHECK(FMI3ExitInitializationMode(m));
    } else {
        CHECK(FMI2Instantiate(m, "file:///", fmi2CoSimulation, words[3], fmi2False, fmi2False));
        CHECK(FMI2SetupExperiment(m, fmi2False, 0.0, 0.0, fmi2False, 0.0));
        CHECK(FMI2EnterInitializationMode(m));
        CHECK(FMI2ExitInitializationMode(m));
    }
    for (long step = 0; step < steps; step++) {
        double value = step % 200 < 100 ? 1e-3 : -0.8e-3, reached;
        bool event, terminate, early;
        if (third) {
            CHECK(FMI3SetFloat64(m, &command, 1, &value, 1));
            CHECK(FMI3DoStep(m, step * PERIOD, PERIOD, 1, &event, &terminate, &early, &reached));
        } else {
            CHECK(FMI2SetReal(m, &command, 1, &value));
            CHECK(FMI2DoStep(m, step * PERIOD, PERIOD, fmi2True));
        }
    }
    for (int word = 6; word < count; word++) {
        unsigned int place = (unsigned int)atoi(words[word]);
        double value;
        CHECK(third ? FMI3GetFloat64(m, &place, 1, &value, 1) : FMI2GetReal(m, &place, 1, &value));
        printf("%a\n", value);
    }
    if (third) FMI3FreeInstance(m);
    else FMI2FreeInstance(m);
    FMIFreeInstance(m);
    return 0;
}
