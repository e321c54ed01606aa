/*
 * A MODBUS-TCP server by libmodbus: epoll tells which connections have something, the library reads and answers.
 *
 * Serves 100 holding registers from FD00H on a free port of loopback, prints the port, and ends when its standard
 * input closes.
 */
#include <arpa/inet.h>
#include <modbus.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <unistd.h>

enum { START = 0xFD00, REGISTERS = 100, BACKLOG = 128, EVENTS = 256 };

static void watch(int poll, int descriptor)
{
    struct epoll_event event = {.events = EPOLLIN, .data.fd = descriptor};
    epoll_ctl(poll, EPOLL_CTL_ADD, descriptor, &event);
}

static int listening(void)
{
    struct sockaddr_in at = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    socklen_t size = sizeof at;
    int descriptor = socket(AF_INET, SOCK_STREAM, 0);
    if (bind(descriptor, (struct sockaddr *)&at, size) < 0 || listen(descriptor, BACKLOG) < 0)
        return -1;
    getsockname(descriptor, (struct sockaddr *)&at, &size);
    printf("%d\n", ntohs(at.sin_port));
    fflush(stdout);
    return descriptor;
}

static void serve(modbus_t *context, modbus_mapping_t *mapping, int descriptor)
{
    uint8_t request[MODBUS_TCP_MAX_ADU_LENGTH];
    modbus_set_socket(context, descriptor);
    int size = modbus_receive(context, request);
    if (size < 0)
        close(descriptor);
    else if (size > 0)
        modbus_reply(context, request, size, mapping);
}

int main(void)
{
    modbus_t *context = modbus_new_tcp("127.0.0.1", 0);
    modbus_mapping_t *mapping = modbus_mapping_new_start_address(0, 0, 0, 0, START, REGISTERS, 0, 0);
    int listener = listening(), poll = epoll_create1(0), on = 1;
    if (context == NULL || mapping == NULL || listener < 0)
        return 1;
    for (int i = 0; i < REGISTERS; i++)
        mapping->tab_registers[i] = i;
    watch(poll, listener);
    watch(poll, STDIN_FILENO);
    for (;;) {
        struct epoll_event ready[EVENTS];
        int many = epoll_wait(poll, ready, EVENTS, -1);
        for (int i = 0; i < many; i++) {
            int descriptor = ready[i].data.fd;
            if (descriptor == STDIN_FILENO)
                return 0;
            if (descriptor == listener) {
                int client = accept(listener, NULL, NULL);
                setsockopt(client, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
                watch(poll, client);
            } else {
                serve(context, mapping, descriptor);
            }
        }
    }
}
