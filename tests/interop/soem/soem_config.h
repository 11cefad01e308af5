/* Microseconds that SOEM's tools wait: so long that a busy machine is not taken for a missing device. */
#define EC_TIMEOUTRET 100000
#define EC_TIMEOUTRET3 (EC_TIMEOUTRET * 3)
#define EC_TIMEOUTSAFE 1000000
#define EC_TIMEOUTEEP 1000000
#define EC_TIMEOUTTXM 1000000
#define EC_TIMEOUTRXM 5000000
#define EC_TIMEOUTSTATE 10000000
