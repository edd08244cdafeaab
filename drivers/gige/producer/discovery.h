/* Where cameras are looked for, and what they tell of themselves. */
#ifndef TRONLAB_DISCOVERY_H
#define TRONLAB_DISCOVERY_H

#include <net/if.h>
#include <netinet/in.h>
#include <stdbool.h>

#include "gentl.h"

/* The environment variable that lists the routes, and what it is taken to be when unset. */
#define ROUTES_VARIABLE "TRONLAB_GEV_INTERFACES"
#define ROUTES_DEFAULT "lo"

enum { MAX_ROUTES = 16, MAX_CAMERAS = 32 };

/* One entry of the list: a network interface, or the address of one camera. */
struct route {
    char name[32];
    struct in_addr from;       /* the host's own address; INADDR_ANY: as routed */
    struct sockaddr_in target; /* whom to ask */
    bool is_broadcast;
};

/* The strings are what the camera's registers hold, ended by 0. */
struct camera {
    char id[48]; /* SERIAL@A.B.C.D:PORT; the hardware address where there is no serial number */
    char vendor[33];
    char model[33];
    char version[33];
    char serial[17];
    char user_name[17];
    uint64_t mac;
    struct sockaddr_in address;
};

/* Read a list such as "lo,enp3s0,192.168.3.7:3956". Only the interfaces and cameras it names are
 * ever sent anything. Fails naming the entry that is neither. */
GC_ERROR routes_parse(const char *list, struct route *routes, size_t *n_routes);

/* Ask along one route, for at most `timeout_ms`; one camera's address ends it at the answer. */
GC_ERROR discover(const struct route *route, uint64_t timeout_ms, struct camera *cameras,
                  size_t *n_cameras);

/* Read the payload of a discovery acknowledge; false if it is too short. */
bool camera_parse(const uint8_t *payload, size_t size, const struct sockaddr_in *from,
                  struct camera *camera);

#endif
