/* A stand-in for the header of Simulink, with what the generated S-function uses: it shows that the text is C. */
#ifndef SIMSTRUC_H
#define SIMSTRUC_H
#include <stddef.h>
typedef int int_T;
typedef struct { int dummy; } SimStruct;
typedef struct { int dummy; } mxArray;
void ssSetNumSFcnParams(SimStruct *S, int n);
int ssGetNumSFcnParams(SimStruct *S);
int ssGetSFcnParamsCount(SimStruct *S);
int ssSetNumInputPorts(SimStruct *S, int n);
int ssSetNumOutputPorts(SimStruct *S, int n);
void ssSetInputPortWidth(SimStruct *S, int port, int n);
void ssSetInputPortRequiredContiguous(SimStruct *S, int port, int n);
void ssSetInputPortDirectFeedThrough(SimStruct *S, int port, int n);
void ssSetOutputPortWidth(SimStruct *S, int port, int n);
void ssSetNumSampleTimes(SimStruct *S, int n);
void ssSetNumPWork(SimStruct *S, int n);
void ssSetOptions(SimStruct *S, int n);
void ssSetSampleTime(SimStruct *S, int k, double t);
void ssSetOffsetTime(SimStruct *S, int k, double t);
const mxArray *ssGetSFcnParam(SimStruct *S, int k);
void ssSetPWorkValue(SimStruct *S, int k, void *value);
void *ssGetPWorkValue(SimStruct *S, int k);
void ssSetErrorStatus(SimStruct *S, const char *message);
const void *ssGetInputPortSignal(SimStruct *S, int port);
double *ssGetOutputPortRealSignal(SimStruct *S, int port);
int ssIsMajorTimeStep(SimStruct *S);
size_t mxGetNumberOfElements(const mxArray *a);
double *mxGetPr(const mxArray *a);
#endif
