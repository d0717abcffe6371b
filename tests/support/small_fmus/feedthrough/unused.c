/* FMI functions of other interfaces that a host wants to find: each answers fmi2Error, fmi3Error. */
#define STUB(name) int name(void) { return 3; }
STUB(fmi2GetBooleanStatus) STUB(fmi2GetRealStatus) STUB(fmi3CompletedIntegratorStep) STUB(fmi3EnterContinuousTimeMode)
STUB(fmi3EnterEventMode) STUB(fmi3GetContinuousStateDerivatives) STUB(fmi3GetContinuousStates)
STUB(fmi3GetEventIndicators) STUB(fmi3GetNominalsOfContinuousStates) STUB(fmi3InstantiateModelExchange)
STUB(fmi3SetContinuousStates) STUB(fmi3SetTime) STUB(fmi3UpdateDiscreteStates)
