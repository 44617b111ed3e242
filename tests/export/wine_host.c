/* A host of the IEEE/CIGRE interface for Windows: the first argument is a library, the second one its sampling period in s.
 * It writes the counts of inputs and outputs as doubles. Then it reads the inputs of a sample and writes its outputs, until
 * there are no more. The parameter "start" is 0: at rest. */
#include <fcntl.h>
#include <io.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <windows.h>

typedef struct {
    const char *Name, *Description, *Unit;
    int32_t DataType, Width;
} signal_t;

typedef struct {
    const char *Name, *GroupName, *Description, *Unit;
    int32_t DataType, FixedValue;
    double Default, Min, Max;
} parameter_t;

typedef struct {
    uint8_t Version[4];
    const char *texts[10];
    double FixedStepBaseSampleTime;
    uint8_t EMT_RMS_Mode;
    int32_t NumInputPorts;
    const signal_t *InputPortsInfo;
    int32_t NumOutputPorts;
    const signal_t *OutputPortsInfo;
    int32_t NumParameters;
    const parameter_t *ParametersInfo;
    int32_t NumIntStates, NumFloatStates, NumDoubleStates;
} info_t;

typedef struct {
    void *ExternalInputs, *ExternalOutputs, *Parameters;
    double Time;
    uint8_t SimTool_EMT_RMS_Mode;
    const char *LastErrorMessage, *LastGeneralMessage;
    int32_t *IntStates;
    float *FloatStates;
    double *DoubleStates;
} instance_t;

typedef const info_t *(__cdecl *info_f)(void);
typedef int32_t(__cdecl *call_f)(instance_t *);

static FARPROC named(HMODULE library, const char *name)
{
    const FARPROC found = GetProcAddress(library, name);
    if (found == NULL) {
        fprintf(stderr, "there is no %s\n", name);
        exit(2);
    }
    return found;
}

static void called(call_f call, instance_t *instance)
{
    if (call(instance) != 0) {
        fprintf(stderr, "%s\n", instance->LastErrorMessage);
        exit(3);
    }
}

int main(int count, char **arguments)
{
    const HMODULE library = (count == 3) ? LoadLibraryA(arguments[1]) : NULL;
    instance_t one;
    const info_t *info;
    double counts[2], *parameters;
    long k;
    if (library == NULL) {
        fprintf(stderr, "no library\n");
        return 1;
    }
    (void)_setmode(_fileno(stdin), _O_BINARY);
    (void)_setmode(_fileno(stdout), _O_BINARY);
    info = ((info_f)(void (*)(void))named(library, "Model_GetInfo"))();
    memset(&one, 0, sizeof one);
    one.SimTool_EMT_RMS_Mode = 1;
    one.ExternalInputs = calloc((size_t)info->NumInputPorts, sizeof(double));
    one.ExternalOutputs = calloc((size_t)info->NumOutputPorts, sizeof(double));
    one.DoubleStates = calloc((size_t)info->NumDoubleStates, sizeof(double));
    parameters = calloc((size_t)info->NumParameters, sizeof(double));
    one.Parameters = parameters;
    for (k = 0; k < info->NumParameters; ++k) {
        parameters[k] = (strcmp(info->ParametersInfo[k].Name, "start") == 0) ? 0.0 : info->ParametersInfo[k].Default;
    }
    counts[0] = info->NumInputPorts;
    counts[1] = info->NumOutputPorts;
    fwrite(counts, sizeof counts, 1U, stdout);
    fflush(stdout);
    for (k = 0; fread(one.ExternalInputs, sizeof(double), (size_t)info->NumInputPorts, stdin) ==
                (size_t)info->NumInputPorts;
         ++k) {
        one.Time = (double)k * atof(arguments[2]);
        if (k == 0) {
            called((call_f)(void (*)(void))named(library, "Model_FirstCall"), &one);
            called((call_f)(void (*)(void))named(library, "Model_CheckParameters"), &one);
        }
        called((call_f)(void (*)(void))named(library, "Model_Outputs"), &one);
        fwrite(one.ExternalOutputs, sizeof(double), (size_t)info->NumOutputPorts, stdout);
        fflush(stdout);
    }
    return 0;
}
