/* Ports: the camera's own registers, and the few that this producer has of its own.
 *
 * Each module describes itself by a GenICam file in its own memory: whole numbers of 8 bytes from
 * address 0, the file at FILE_ADDRESS. */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "modules.h"

enum { FILE_ADDRESS = 0x10000, FILE_ROOM = 8192, REGISTER_SIZE = 8 };

struct own_register {
    const char *name; /* as in the GenTL feature naming convention, where it has one */
    uint64_t (*read)(void *module);
};

static uint64_t camera_address(void *module)
{
    return ntohl(((struct device *)module)->camera.address.sin_addr.s_addr);
}

static uint64_t camera_mac(void *module)
{
    return ((struct device *)module)->camera.mac;
}

static uint64_t n_delivered(void *module)
{
    struct stream *stream = module;
    pthread_mutex_lock(&stream->lock);
    uint64_t n = stream->n_delivered;
    pthread_mutex_unlock(&stream->lock);
    return n;
}

static uint64_t n_lost(void *module)
{
    struct assembly_counts counts = stream_counts(module);
    return counts.skipped + counts.underruns;
}

static uint64_t n_incomplete(void *module)
{
    return stream_counts(module).incomplete;
}

static uint64_t n_underruns(void *module)
{
    return stream_counts(module).underruns;
}

static uint64_t n_requested(void *module)
{
    return stream_counts(module).packets_requested;
}

static uint64_t n_refused(void *module)
{
    return stream_counts(module).packets_refused;
}

static uint64_t n_malformed(void *module)
{
    return stream_counts(module).packets_malformed;
}

static const struct own_register DEVICE_REGISTERS[] = {
    {"GevDeviceIPAddress", camera_address}, {"GevDeviceMACAddress", camera_mac}, {NULL, NULL}};
static const struct own_register STREAM_REGISTERS[] = {
    {"StreamDeliveredFrameCount", n_delivered},
    {"StreamLostFrameCount", n_lost},
    {"StreamIncompleteFrameCount", n_incomplete},
    {"StreamUnderrunFrameCount", n_underruns},
    {"StreamRequestedPacketCount", n_requested},
    {"StreamRefusedPacketCount", n_refused},
    {"StreamMalformedPacketCount", n_malformed},
    {NULL, NULL}};
static const struct own_register NO_REGISTERS[] = {{NULL, NULL}};

/* How a kind of module shows itself as a port. */
struct face {
    const char *module; /* as the standard names it */
    const char *port;
    const struct own_register *registers;
};

static struct face face_of(enum module_kind kind)
{
    switch (kind) {
    case MODULE_SYSTEM:
        return (struct face){"TLSystem", "TLPort", NO_REGISTERS};
    case MODULE_INTERFACE:
        return (struct face){"TLInterface", "InterfacePort", NO_REGISTERS};
    case MODULE_DEVICE:
        return (struct face){"TLDevice", "DevicePort", DEVICE_REGISTERS};
    case MODULE_STREAM:
        return (struct face){"TLDataStream", "StreamPort", STREAM_REGISTERS};
    default:
        return (struct face){"Device", "Device", NO_REGISTERS};
    }
}

struct text {
    char bytes[FILE_ROOM];
    size_t size;
};

static void append(struct text *text, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

static void append(struct text *text, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    int size = vsnprintf(text->bytes + text->size, FILE_ROOM - text->size, format, arguments);
    va_end(arguments);
    if (size > 0)
        text->size += (size_t)size;
}

/* The GenICam file of a module of this producer. */
static void describe(const struct face *face, struct text *file)
{
    file->size = 0;
    append(file,
           "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<RegisterDescription ModelName=\"%s\" "
           "VendorName=\"" PRODUCER_VENDOR "\" StandardNameSpace=\"None\" "
           "SchemaMajorVersion=\"1\" SchemaMinorVersion=\"1\" SchemaSubMinorVersion=\"0\" "
           "MajorVersion=\"1\" MinorVersion=\"0\" SubMinorVersion=\"0\" "
           "ProductGuid=\"5f6e1c8a-53b3-4a0e-9d2e-1b1f5d6c7a01\" "
           "VersionGuid=\"5f6e1c8a-53b3-4a0e-9d2e-1b1f5d6c7a02\" "
           "xmlns=\"http://www.genicam.org/GenApi/Version_1_1\">\n<Category Name=\"Root\">",
           face->module);
    for (const struct own_register *own = face->registers; own->name; own++)
        append(file, "<pFeature>%s</pFeature>", own->name);
    append(file, "</Category>\n");
    for (const struct own_register *own = face->registers; own->name; own++)
        append(file,
               "<IntReg Name=\"%s\"><Address>%zu</Address><Length>%d</Length>"
               "<AccessMode>RO</AccessMode><pPort>%s</pPort><Cachable>NoCache</Cachable>"
               "<Sign>Unsigned</Sign><Endianess>LittleEndian</Endianess></IntReg>\n",
               own->name, (size_t)(own - face->registers) * REGISTER_SIZE, REGISTER_SIZE,
               face->port);
    append(file, "<Port Name=\"%s\"/>\n</RegisterDescription>\n", face->port);
}

static GC_ERROR read_own(const struct face *face, void *module, uint64_t address, uint8_t *bytes,
                         size_t size)
{
    struct text file;
    size_t n_registers = 0;
    while (face->registers[n_registers].name)
        n_registers++;
    describe(face, &file);
    if (address < n_registers * REGISTER_SIZE && size == REGISTER_SIZE &&
        address % REGISTER_SIZE == 0) {
        uint64_t value = face->registers[address / REGISTER_SIZE].read(module);
        for (size_t i = 0; i < REGISTER_SIZE; i++)
            bytes[i] = (uint8_t)(value >> 8 * i);
        return GC_ERR_SUCCESS;
    }
    if (address < FILE_ADDRESS || address - FILE_ADDRESS > file.size ||
        size > file.size - (address - FILE_ADDRESS))
        return fail(GC_ERR_INVALID_ADDRESS, "%s has no %zu bytes at 0x%llx", face->module, size,
                    (unsigned long long)address);
    memcpy(bytes, file.bytes + (address - FILE_ADDRESS), size);
    return GC_ERR_SUCCESS;
}

/* A port that is in use; its handle must be unpinned. */
struct port {
    void *module;
    enum module_kind kind;
    struct face face;
};

static bool pin_port(void *handle, struct port *port)
{
    port->module = handle_pin_any(handle, &port->kind);
    if (!port->module)
        return false;
    port->face = face_of(port->kind);
    if (port->kind != MODULE_BUFFER && port->kind != MODULE_EVENT)
        return true;
    handle_unpin(handle);
    fail(GC_ERR_INVALID_HANDLE, "buffers and events have no port here");
    return false;
}

GC_API GCReadPort(PORT_HANDLE handle, uint64_t address, void *buffer, size_t *size)
{
    struct port port;
    if (!buffer || !size)
        return fail(GC_ERR_INVALID_PARAMETER, "the pointer to the data or their size is NULL");
    if (!pin_port(handle, &port))
        return last_error_code();
    GC_ERROR error =
        port.kind == MODULE_REMOTE_DEVICE
            ? gvcp_read(((struct device *)port.module)->channel, address, buffer, *size)
            : read_own(&port.face, port.module, address, buffer, *size);
    handle_unpin(handle);
    return error;
}

GC_API GCWritePort(PORT_HANDLE handle, uint64_t address, const void *buffer, size_t *size)
{
    struct port port;
    if (!buffer || !size)
        return fail(GC_ERR_INVALID_PARAMETER, "the pointer to the data or their size is NULL");
    if (!pin_port(handle, &port))
        return last_error_code();
    GC_ERROR error =
        port.kind == MODULE_REMOTE_DEVICE
            ? gvcp_write(((struct device *)port.module)->channel, address, buffer, *size)
            : fail(GC_ERR_ACCESS_DENIED, "%s can only be read", port.face.module);
    handle_unpin(handle);
    return error;
}

GC_API GCReadPortStacked(PORT_HANDLE handle, PORT_REGISTER_STACK_ENTRY *entries, size_t *count)
{
    for (size_t i = 0; i < *count; i++) {
        GC_ERROR error =
            GCReadPort(handle, entries[i].Address, entries[i].pBuffer, &entries[i].Size);
        if (error) {
            *count = i;
            return error;
        }
    }
    return GC_ERR_SUCCESS;
}

GC_API GCWritePortStacked(PORT_HANDLE handle, PORT_REGISTER_STACK_ENTRY *entries, size_t *count)
{
    for (size_t i = 0; i < *count; i++) {
        GC_ERROR error =
            GCWritePort(handle, entries[i].Address, entries[i].pBuffer, &entries[i].Size);
        if (error) {
            *count = i;
            return error;
        }
    }
    return GC_ERR_SUCCESS;
}

static uint32_t n_urls(const struct port *port)
{
    return port->kind == MODULE_REMOTE_DEVICE ? ((struct device *)port->module)->n_urls : 1;
}

static void url_of(const struct port *port, uint32_t index, char *url, size_t room)
{
    if (port->kind == MODULE_REMOTE_DEVICE) {
        snprintf(url, room, "%s", ((struct device *)port->module)->urls[index]);
        return;
    }
    struct text file;
    describe(&port->face, &file);
    snprintf(url, room, "Local:" PRODUCER_NAME "_%s.xml;%x;%zx", port->face.module, FILE_ADDRESS,
             file.size);
}

/* "Local:NAME;ADDRESS;SIZE" with hexadecimal numbers, perhaps "///" before NAME and "?..." after
 * SIZE. */
static GC_ERROR local_url_info(char *url, int32_t command, struct answer answer)
{
    char *name = strchr(url, ':');
    char *address = name ? strchr(name, ';') : NULL;
    char *size = address ? strchr(address + 1, ';') : NULL;
    if (!size)
        return fail(GC_ERR_NOT_AVAILABLE, "'%s' is not in the camera's memory", url);
    switch (command) {
    case URL_INFO_FILE_REGISTER_ADDRESS:
        return answer_uint64(answer, strtoull(address + 1, NULL, 16));
    case URL_INFO_FILE_SIZE:
        return answer_uint64(answer, strtoull(size + 1, NULL, 16));
    case URL_INFO_SCHEME:
        return answer_int32(answer, URL_SCHEME_LOCAL);
    default:
        *address = '\0';
        name += 1 + strspn(name + 1, "/");
        return answer_string(answer, name);
    }
}

static GC_ERROR url_info(const struct port *port, uint32_t index, int32_t command,
                         struct answer answer)
{
    char url[GVCP_URL_SIZE + 1];
    if (index >= n_urls(port))
        return fail(GC_ERR_INVALID_INDEX, "URL %u of %u", index, n_urls(port));
    url_of(port, index, url, sizeof url);
    switch (command) {
    case URL_INFO_URL:
        return answer_string(answer, url);
    case URL_INFO_FILE_REGISTER_ADDRESS:
    case URL_INFO_FILE_SIZE:
    case URL_INFO_SCHEME:
    case URL_INFO_FILENAME:
        return local_url_info(url, command, answer);
    default:
        return fail(GC_ERR_NOT_AVAILABLE, "URL information %d: only the file itself tells",
                    command);
    }
}

GC_API GCGetNumPortURLs(PORT_HANDLE handle, uint32_t *count)
{
    struct port port;
    if (!pin_port(handle, &port))
        return last_error_code();
    *count = n_urls(&port);
    handle_unpin(handle);
    return GC_ERR_SUCCESS;
}

GC_API GCGetPortURLInfo(PORT_HANDLE handle, uint32_t index, int32_t command, INFO_DATATYPE *type,
                        void *buffer, size_t *size)
{
    struct port port;
    if (!pin_port(handle, &port))
        return last_error_code();
    GC_ERROR error = url_info(&port, index, command, (struct answer){type, buffer, size});
    handle_unpin(handle);
    return error;
}

GC_API GCGetPortURL(PORT_HANDLE handle, char *url, size_t *size)
{
    return GCGetPortURLInfo(handle, 0, URL_INFO_URL, NULL, url, size);
}

static const char *id_of(const struct port *port)
{
    switch (port->kind) {
    case MODULE_INTERFACE:
        return ((struct interface *)port->module)->route.name;
    case MODULE_DEVICE:
    case MODULE_REMOTE_DEVICE:
        return ((struct device *)port->module)->camera.id;
    case MODULE_STREAM:
        return STREAM_ID;
    default:
        return PRODUCER_NAME;
    }
}

static GC_ERROR port_info(const struct port *port, int32_t command, struct answer answer)
{
    bool is_camera = port->kind == MODULE_REMOTE_DEVICE;
    const struct camera *camera = is_camera ? &((struct device *)port->module)->camera : NULL;
    switch (command) {
    case PORT_INFO_ID:
        return answer_string(answer, id_of(port));
    case PORT_INFO_VENDOR:
        return answer_string(answer, camera ? camera->vendor : PRODUCER_VENDOR);
    case PORT_INFO_MODEL:
        return answer_string(answer, camera ? camera->model : port->face.module);
    case PORT_INFO_TLTYPE:
        return answer_string(answer, TRANSPORT);
    case PORT_INFO_MODULE:
        return answer_string(answer, port->face.module);
    case PORT_INFO_LITTLE_ENDIAN:
        return answer_bool(answer, !is_camera);
    case PORT_INFO_BIG_ENDIAN:
    case PORT_INFO_ACCESS_WRITE:
        return answer_bool(answer, is_camera);
    case PORT_INFO_ACCESS_READ:
        return answer_bool(answer, true);
    case PORT_INFO_ACCESS_NA:
    case PORT_INFO_ACCESS_NI:
        return answer_bool(answer, false);
    case PORT_INFO_VERSION:
        return answer_string(answer, PRODUCER_VERSION);
    case PORT_INFO_PORTNAME:
        return answer_string(answer, port->face.port);
    default:
        return fail(GC_ERR_NOT_IMPLEMENTED, "port information %d is not known here", command);
    }
}

GC_API GCGetPortInfo(PORT_HANDLE handle, int32_t command, INFO_DATATYPE *type, void *buffer,
                     size_t *size)
{
    struct port port;
    if (!pin_port(handle, &port))
        return last_error_code();
    GC_ERROR error = port_info(&port, command, (struct answer){type, buffer, size});
    handle_unpin(handle);
    return error;
}
