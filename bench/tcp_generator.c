/*
 * Puts a load on a MODBUS-TCP server: many connections, one request outstanding on each, answers verified.
 *
 * usage: tcp_generator PORT CONNECTIONS UNIT START COUNT SECONDS
 *
 * Connects to loopback, reads registers by function 03 with a transaction id that counts on, and checks of each answer
 * the transaction, the protocol, the length, the unit, the function and the byte count. Prints one line: answers, seconds
 * elapsed, processor seconds of this process, and the answer times' median, 99th percentile and maximum in
 * microseconds. Ends with 1 and the reason on standard error where an answer is wrong or late.
 */
#include <arpa/inet.h>
#include <errno.h>
#include <netinet/tcp.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum {
    REQUEST = 12,                /* bytes */
    HEAD = 9,                    /* bytes of an answer in front of its words */
    MOST = HEAD + 2 * 125,       /* bytes of the longest answer */
    BUCKETS = 1000000,           /* of one microsecond; what takes longer is in the last one */
    ANSWER_WITHIN = 5000,        /* milliseconds */
    EVENTS = 256
};

struct client {
    int descriptor;
    int received; /* bytes of the answer */
    uint16_t transaction;
    int64_t sent_at; /* nanoseconds */
    uint8_t answer[MOST + 1];
};

static uint32_t histogram[BUCKETS];
static int unit, start, count;

static void fail(const char *what)
{
    fprintf(stderr, "%s\n", what);
    exit(1);
}

static int64_t now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return time.tv_sec * 1000000000LL + time.tv_nsec;
}

static double processor_seconds(void)
{
    struct rusage used;
    getrusage(RUSAGE_SELF, &used);
    return used.ru_utime.tv_sec + used.ru_stime.tv_sec + (used.ru_utime.tv_usec + used.ru_stime.tv_usec) / 1e6;
}

static int connected(int port)
{
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons(port), .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    int on = 1, descriptor = socket(AF_INET, SOCK_STREAM, 0);
    if (descriptor < 0 || connect(descriptor, (struct sockaddr *)&to, sizeof to) < 0)
        fail(strerror(errno));
    setsockopt(descriptor, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    return descriptor;
}

static void ask(struct client *client, int64_t moment)
{
    uint16_t transaction = ++client->transaction;
    uint8_t request[REQUEST] = {transaction >> 8, transaction & 0xFF, 0, 0, 0, 6, unit, 3,
                                start >> 8, start & 0xFF, count >> 8, count & 0xFF};
    client->received = 0;
    client->sent_at = moment;
    if (send(client->descriptor, request, REQUEST, MSG_NOSIGNAL) != REQUEST)
        fail("a request could not be sent");
}

static void check(const struct client *client)
{
    const uint8_t *got = client->answer;
    int length = 3 + 2 * count;
    uint8_t head[HEAD] = {client->transaction >> 8, client->transaction & 0xFF, 0, 0, length >> 8, length & 0xFF,
                          unit, 3, 2 * count};
    if (client->received > HEAD + 2 * count || memcmp(got, head, HEAD) != 0) {
        fprintf(stderr, "wrong answer:");
        for (int i = 0; i < client->received; i++)
            fprintf(stderr, " %02x", got[i]);
        fail("");
    }
}

/* Takes what has arrived; returns 1 where the answer is whole. */
static int is_answered(struct client *client)
{
    int size = HEAD + 2 * count;
    ssize_t more = recv(client->descriptor, client->answer + client->received, size + 1 - client->received, 0);
    if (more <= 0)
        fail("the server has closed a connection");
    client->received += more;
    if (client->received >= HEAD && client->received < size)
        check(client); /* an exception is shorter, and would be waited for in vain */
    if (client->received < size)
        return 0;
    check(client);
    return 1;
}

static void note(int64_t nanoseconds)
{
    int64_t bucket = nanoseconds / 1000;
    histogram[bucket < BUCKETS ? bucket : BUCKETS - 1]++;
}

static int percentile(uint64_t answered, double share)
{
    uint64_t below = 0, wanted = (uint64_t)(share * (answered - 1));
    for (int bucket = 0; bucket < BUCKETS; bucket++)
        if ((below += histogram[bucket]) > wanted)
            return bucket;
    return BUCKETS - 1;
}

int main(int many, char **arguments)
{
    if (many != 7)
        fail("usage: tcp_generator PORT CONNECTIONS UNIT START COUNT SECONDS");
    int port = atoi(arguments[1]), connections = atoi(arguments[2]);
    unit = atoi(arguments[3]), start = atoi(arguments[4]), count = atoi(arguments[5]);
    double seconds = atof(arguments[6]);
    if (connections < 1 || count < 1 || count > 125)
        fail("at least one connection, 1 to 125 registers");
    struct client *clients = calloc(connections, sizeof *clients);
    struct epoll_event ready[EVENTS];
    int poll = epoll_create1(0);
    for (int i = 0; i < connections; i++) {
        struct epoll_event event = {.events = EPOLLIN, .data.ptr = &clients[i]};
        clients[i].descriptor = connected(port);
        clients[i].transaction = i * 257;
        epoll_ctl(poll, EPOLL_CTL_ADD, clients[i].descriptor, &event);
    }
    double used = processor_seconds();
    int64_t begun = now(), end = begun + (int64_t)(seconds * 1e9), moment = begun;
    uint64_t answered = 0;
    for (int i = 0; i < connections; i++)
        ask(&clients[i], now());
    while (moment < end) {
        int many_ready = epoll_wait(poll, ready, EVENTS, ANSWER_WITHIN);
        if (many_ready < 1)
            fail("no answer");
        for (int i = 0; i < many_ready; i++) {
            struct client *client = ready[i].data.ptr;
            if (!is_answered(client))
                continue;
            moment = now();
            note(moment - client->sent_at);
            answered++;
            ask(client, moment);
        }
        moment = now();
    }
    printf("%llu %.6f %.6f %d %d %d\n", (unsigned long long)answered, (moment - begun) / 1e9,
           processor_seconds() - used, percentile(answered, 0.5), percentile(answered, 0.99), percentile(answered, 1));
    return 0;
}
